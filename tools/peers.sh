#!/bin/sh
# Install the packages that tests compare results with; without them these tests are skipped.
# Usage: peers.sh PYTHON
set -u

python=$1
# Usage: debian PACKAGE SUBJECT; without the package the tests of SUBJECT are skipped
debian() {
  command="apt-get update -qq && apt-get install --yes -qq $1"
  if ! command -v apt-get >/dev/null 2>&1; then
    echo "Without $1 the tests of $2 are skipped."
  elif [ "$(id -u)" -eq 0 ]; then
    sh -c "export DEBIAN_FRONTEND=noninteractive; $command" >/dev/null 2>&1 ||
      echo "$1 could not be installed; the tests of $2 are skipped."
  elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    sudo -n sh -c "export DEBIAN_FRONTEND=noninteractive; $command" >/dev/null 2>&1 ||
      echo "$1 could not be installed; the tests of $2 are skipped."
  else
    echo "Without $1 the tests of $2 are skipped: sudo sh -c '$command'"
  fi
}

if [ ! -e /usr/lib/x86_64-linux-gnu/libminpack.so.1 ] && ! ldconfig -p 2>/dev/null | grep -q libminpack; then
  debian minpack-dev MINPACK
fi
command -v mpiexec >/dev/null 2>&1 || debian openmpi-bin MPI
command -v pdflatex >/dev/null 2>&1 || debian "--no-install-recommends texlive-latex-recommended" TeX
for package in "numba>=0.60" "lielab==0.5.2" "distributed>=2024.8" "loky>=3.4" "mpi4py>=4.0" \
  "zarr>=3.0" "h5py>=3.11" "kauri>=2.3" "nodepy>=1.1" six "diffrax>=0.7" "jax>=0.5" jaxlie \
  "xarray>=2024.1" "qutip>=5.3" cython; do
  "$python" -m pip install --quiet "$package" >/dev/null 2>&1 ||
    echo "$package could not be installed; the tests that need it are skipped."
done
exit 0
