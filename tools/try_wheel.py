"""Test an installed wheel: its libraries, its files, and the tests without other dependencies.

Run ``python tools/try_wheel.py TESTS`` outside of the source tree; `tools/wheel.sh` does.
"""

import os
import subprocess
import sys
from importlib.metadata import files, metadata
from importlib.util import find_spec
from pathlib import Path

TESTS = (
    "package/test_installation.py",
    "package/test_typing.py",
    "trees/test_trees.py",
    "support/test_quad.py",
    "catalogue/test_catalogue.py",
    "integration/test_integrate.py",
    "integration/test_compiled_output.py",
)
LIBRARIES = ("libgfortran", "libquadmath")


def check_libraries() -> None:
    """Make sure that compiled modules load, and with what they brought along."""
    import cg
    import cg._core_r64

    if find_spec("cg._core_r128") is None:
        print("built without quadruple precision")
        return
    assert "site-packages" in str(cg.__file__), cg.__file__
    method = cg.search(order=3, stages=3, starts=4, seed=1).methods[0]
    assert method.order == 3
    maps = Path("/proc/self/maps")
    if maps.exists():
        loaded = {line.split()[-1] for line in maps.read_text().splitlines()}
        used = {path for path in loaded if any(name in path for name in LIBRARIES)}
        assert any("crouch_grossman.libs" in path for path in used), used
        assert all("site-packages" in path for path in used), used
        print("libraries:", *sorted(Path(path).name for path in used))


def check_files() -> None:
    """Make sure that licences and marks of types are in the wheel."""
    names = {str(path) for path in files("crouch-grossman") or ()}
    for mark in ("cg/py.typed", "crouch_grossman/py.typed"):
        assert mark in names, mark
    for licence in ("LICENSE", "MINPACK.txt", "GPL-3.0.txt", "LGPL-2.1.txt"):
        assert any(name.endswith(f"/{licence}") for name in names), licence
    about = metadata("crouch-grossman")
    assert about["License-Expression"] == "MIT", about["License-Expression"]


if __name__ == "__main__":
    check_libraries()
    check_files()
    folder = Path(sys.argv[1])
    command = [sys.executable, "-m", "pytest", "-q", *TESTS]
    print("libraries of the system hidden:", os.environ.get("WITHOUT_FORTRAN", "0") == "1")
    sys.exit(subprocess.run(command, cwd=folder, check=False).returncode)
