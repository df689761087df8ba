#!/bin/sh
# Install what pip can't: a Fortran compiler, and Python with venv and headers.
set -eu

missing=""
command -v gfortran >/dev/null 2>&1 || missing="$missing gfortran"
command -v gcc >/dev/null 2>&1 || missing="$missing gcc"
if ! command -v python3 >/dev/null 2>&1; then
  missing="$missing python3 python3-venv python3-dev"
else
  if ! python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
    echo "Python 3.11 or later is needed; python3 here is $(python3 --version 2>&1)." >&2
    echo "Put a newer one first on PATH and run make again." >&2
    exit 1
  fi
  python3 -c 'import venv, ensurepip' >/dev/null 2>&1 || missing="$missing python3-venv"
  headers=$(python3 -c 'import sysconfig; print(sysconfig.get_path("include"))')
  [ -f "$headers/Python.h" ] || missing="$missing python3-dev"
fi
[ -n "$missing" ] || exit 0

command="apt-get update && apt-get install --yes$missing"
if ! command -v apt-get >/dev/null 2>&1; then
  echo "Missing here:$missing. Install them with this system's package manager and run make again." >&2
  exit 1
fi
if [ "$(id -u)" -eq 0 ]; then
  echo "Installing$missing"
  sh -c "export DEBIAN_FRONTEND=noninteractive; $command" && exit 0
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
  echo "Installing$missing"
  sudo -n sh -c "export DEBIAN_FRONTEND=noninteractive; $command" && exit 0
fi
echo "Missing here:$missing. Run this, then make again:" >&2
echo "    sudo sh -c '$command'" >&2
exit 1
