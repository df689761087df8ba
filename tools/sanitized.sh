#!/bin/sh
# Run tests on a core compiled with the address and undefined-behaviour sanitizers.
# Usage: sanitized.sh PYTHON [pytest's arguments]
set -eu

python=$1
shift
build=$PWD/build/sanitize
bin=$(cd "$(dirname "$python")" && pwd)
PATH="$bin:$PATH"
export PATH
if [ ! -e "$build/build.ninja" ]; then
  meson setup "$build" -Dbuildtype=debugoptimized -Doptimization=1 -Db_sanitize=address,undefined \
    -Db_lundef=false -Dpython.purelibdir=/pkg -Dpython.platlibdir=/pkg
fi
ninja -C "$build" --quiet
meson install -C "$build" --destdir "$build/stage" --no-rebuild --quiet
# Without `site`, which would find the editable install first.
packages=$("$python" -c "import sysconfig; print(sysconfig.get_path('purelib'))")
# What the interpreter and its packages don't free at exit is no matter of this package. Without the
# C++ library, loaded first, an exception in another package would end the process.
ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1:halt_on_error=1 \
  LD_PRELOAD="$(gcc -print-file-name=libasan.so) $(gcc -print-file-name=libstdc++.so)" PYTHONPATH="$build/stage/pkg:$packages" \
  "$python" -S -P -m pytest -p no:cacheprovider "$@"
