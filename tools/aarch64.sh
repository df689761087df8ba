#!/bin/sh
# Cross-compile the core for Linux aarch64 and test it under qemu, on Debian for x86_64, without root.
# Usage: aarch64.sh FOLDER [TESTS], after `make build`; the compiler and the rest are put into FOLDER.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
work=$(cd "$1" && pwd)
shift
[ $# -gt 0 ] || set -- tests/support/test_quad.py tests/integration/test_integrate.py
cross=$work/cross arm=$work/arm site=$work/site bin=$root/.venv/bin
python=python$("$bin/python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
gcc=$(gcc -dumpversion | cut -d. -f1)

mkdir -p "$work/lists/partial" "$work/cache/archives/partial" "$work/packages" "$cross" "$arm" "$site"
cd "$work/packages"
apt="-o APT::Architectures::=amd64 -o APT::Architectures::=arm64 -o Dir::State::lists=$work/lists
  -o Dir::Cache=$work/cache"
apt-get $apt --quiet=2 update
apt-get $apt --quiet=2 download qemu-user-static binutils-aarch64-linux-gnu \
  gcc-$gcc-aarch64-linux-gnu cpp-$gcc-aarch64-linux-gnu gfortran-$gcc-aarch64-linux-gnu \
  libc6-dev-arm64-cross libc6-arm64-cross linux-libc-dev-arm64-cross libgcc-$gcc-dev-arm64-cross \
  libgfortran-$gcc-dev-arm64-cross libgfortran5-arm64-cross libgcc-s1-arm64-cross \
  $python-minimal:arm64 lib$python-minimal:arm64 lib$python-stdlib:arm64 lib$python-dev:arm64 \
  libc6:arm64 libgfortran5:arm64 libgcc-s1:arm64 libstdc++6:arm64 zlib1g:arm64 libexpat1:arm64 \
  libffi8:arm64 libssl3:arm64 libsqlite3-0:arm64 libbz2-1.0:arm64 liblzma5:arm64 libuuid1:arm64
for file in *_arm64.deb; do dpkg -x "$file" "$arm"; done
for file in *_amd64.deb *_all.deb; do dpkg -x "$file" "$cross"; done
sed -i "s# /usr/aarch64# $cross/usr/aarch64#g" "$cross/usr/aarch64-linux-gnu/lib/libc.so"
export LD_LIBRARY_PATH="$cross/usr/lib/x86_64-linux-gnu" # of the cross compiler

prefix=$cross/usr/bin/aarch64-linux-gnu
cat > "$work/cross.ini" <<END
[binaries]
c = '$prefix-gcc-$gcc'
fortran = '$prefix-gfortran-$gcc'
ar = '$prefix-ar'
strip = '$prefix-strip'
python = '$bin/python'
numpy-config = '$bin/numpy-config'
[host_machine]
system = 'linux'
cpu_family = 'aarch64'
cpu = 'aarch64'
endian = 'little'
[built-in options]
c_args = ['-I$arm/usr/include/$python', '-I$arm/usr/include']
END
cd "$root"
PATH="$bin:$PATH" meson setup --reconfigure "$work/build" --cross-file "$work/cross.ini"
PATH="$bin:$PATH" ninja -C "$work/build"

numpy=$("$bin/python" -c 'import numpy; print(numpy.__version__)')
"$bin/python" -m pip install --quiet --upgrade --target "$site" --only-binary=:all: \
  --platform manylinux_2_28_aarch64 --platform manylinux_2_27_aarch64 --platform manylinux2014_aarch64 \
  "numpy==$numpy" scipy python-flint click lazy-loader threadpoolctl pytest hypothesis
cp -r cg crouch_grossman "$site"
cp -r reproduce "$site/cg/reproduce"
rm -f "$site"/cg/*.so
for module in "$work"/build/fortran/_core_*.so; do
  cp "$module" "$site/cg/$(basename "${module%%.*}").so"
done
mkdir -p "$work/tree"
cp -r tests tools research pyproject.toml "$work/tree"
cd "$work/tree"
# LAPACK sets flags of floating point under qemu that NumPy warns of
PYTHONPATH="$site" exec "$cross/usr/bin/qemu-aarch64-static" -L "$arm" "$arm/usr/bin/$python" -m pytest -q \
  -p no:cacheprovider -m "not slow" -W ignore::RuntimeWarning "$@"
