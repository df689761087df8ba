#!/bin/sh
# Install the packages that tests compare results with; without them these tests are skipped.
# Usage: peers.sh PYTHON [rest]
# Without "rest" the packages of Python that many tests use, with it all others, also Debian's.
set -u

python=$1
# Usage: debian PACKAGE SUBJECT; without the package the tests of SUBJECT are skipped
debian() {
  command="apt-get update -qq && apt-get install --yes -qq $1"
  if ! command -v apt-get >/dev/null 2>&1; then
    echo "Without $1 the tests of $2 are skipped."
  elif [ "$(id -u)" -eq 0 ]; then
    echo "Installing $1 for the tests of $2"
    sh -c "export DEBIAN_FRONTEND=noninteractive; $command" >/dev/null 2>&1 ||
      echo "$1 could not be installed; the tests of $2 are skipped."
  elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    echo "Installing $1 for the tests of $2"
    sudo -n sh -c "export DEBIAN_FRONTEND=noninteractive; $command" >/dev/null 2>&1 ||
      echo "$1 could not be installed; the tests of $2 are skipped."
  else
    echo "Without $1 the tests of $2 are skipped: sudo sh -c '$command'"
  fi
}

pip() {
  for package in "$@"; do
    echo "Installing $package for tests"
    "$python" -m pip install --quiet "$package" >/dev/null 2>&1 ||
      echo "$package could not be installed; the tests that need it are skipped."
  done
}

if [ "${2-}" != rest ]; then
  pip "numba>=0.60" "loky>=3.4" "zarr>=3.0" "h5py>=3.11" "diffrax>=0.7" "jax>=0.5" jaxlie \
    "qutip>=5.3"
  exit 0
fi
if [ ! -e /usr/lib/x86_64-linux-gnu/libminpack.so.1 ] && ! ldconfig -p 2>/dev/null | grep -q libminpack; then
  debian minpack-dev MINPACK
fi
command -v mpiexec >/dev/null 2>&1 || debian openmpi-bin MPI
command -v pdflatex >/dev/null 2>&1 || debian "--no-install-recommends texlive-latex-recommended" TeX
pip "lielab==0.5.2" "distributed>=2024.8" "mpi4py>=4.0" "kauri>=2.3" "casadi>=3.6"
exit 0
