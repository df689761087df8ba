#!/bin/sh
# Install what differential tests compare with, where that can be done; tests skip without it.
# Usage: peers.sh PYTHON
set -u

python=$1
if [ ! -e /usr/lib/x86_64-linux-gnu/libminpack.so.1 ] && ! ldconfig -p 2>/dev/null | grep -q libminpack; then
  command="apt-get update -qq && apt-get install --yes -qq minpack-dev"
  if ! command -v apt-get >/dev/null 2>&1; then
    echo "Without libminpack the tests against MINPACK are skipped."
  elif [ "$(id -u)" -eq 0 ]; then
    sh -c "export DEBIAN_FRONTEND=noninteractive; $command" >/dev/null 2>&1 ||
      echo "minpack-dev could not be installed; the tests against MINPACK are skipped."
  elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    sudo -n sh -c "export DEBIAN_FRONTEND=noninteractive; $command" >/dev/null 2>&1 ||
      echo "minpack-dev could not be installed; the tests against MINPACK are skipped."
  else
    echo "Without libminpack the tests against MINPACK are skipped: sudo sh -c '$command'"
  fi
fi
for package in "numba>=0.60" "lielab==0.5.2"; do
  "$python" -m pip install --quiet "$package" >/dev/null 2>&1 ||
    echo "$package could not be installed; the tests that need it are skipped."
done
exit 0
