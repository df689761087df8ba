#!/bin/sh
# Run a command with the system's libgfortran and libquadmath hidden, by bind mounts in a mount
# namespace of its own. Without permission for that, the command runs as usual.
# Usage: without_fortran.sh COMMAND [ARGUMENT ...]
set -eu

hide='
for file in $(ldconfig -p | sed -n "s/.* => \(.*lib\(gfortran\|quadmath\)\.so.*\)/\1/p"); do
  mount --bind /dev/null "$(readlink -f "$file")"
done
WITHOUT_FORTRAN=1 exec "$@"
'
if unshare --mount true 2>/dev/null; then
  exec unshare --mount --propagation private sh -c "$hide" sh "$@"
fi
echo "The libraries of the system can't be hidden here; what is loaded is looked at all the same." >&2
exec "$@"
