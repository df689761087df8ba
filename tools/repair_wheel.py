"""Add shared libraries and their licences to a wheel, and set its platform tag.

``python tools/repair_wheel.py WHEEL FOLDER`` runs auditwheel, delocate or delvewheel, as the system
needs, and adds the licences to its result. Only auditwheel has been tried.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

LICENCES = Path(__file__).parents[1] / "licenses"
BUNDLED = ("GPL-3.0.txt", "GCC-exception-3.1.txt", "LGPL-2.1.txt")


def output(*command: str | Path) -> str:
    """Return what a command prints; its errors go where ours do."""
    done = subprocess.run([*map(str, command)], check=True, stdout=subprocess.PIPE, text=True)
    return done.stdout


def program(name: str) -> list[str]:
    """Return the command of a program on PATH, where images have it, or of this Python."""
    return [name] if shutil.which(name) else [sys.executable, "-m", name]


def oldest_tag(wheel: Path) -> str:
    """Return the oldest platform that the wheel runs on once its libraries are in it."""
    report = output(*program("auditwheel"), "show", wheel)
    tags = re.findall(r"\"((?:manylinux|musllinux)_\d+_\d+_\w+)\"", report)
    if not tags:
        raise SystemExit(f"auditwheel names no platform for {wheel.name}:\n{report}")
    return tags[-1]


def add_licences(wheel: Path, folder: Path) -> Path:
    """Write the wheel anew with the texts beside its own licence."""
    with tempfile.TemporaryDirectory() as temporary:
        output(sys.executable, "-m", "wheel", "unpack", "--dest", temporary, wheel)
        (content,) = Path(temporary).iterdir()
        (information,) = content.glob("*.dist-info")
        folders = (*content.glob("*.libs"), *content.rglob(".dylibs"))
        libraries = sorted(path.name for folder in folders for path in folder.iterdir())
        target = information / "licenses" / "bundled"
        target.mkdir(parents=True, exist_ok=True)
        for name in BUNDLED:
            shutil.copy(LICENCES / name, target)
        compiler = output(os.environ.get("FC", "gfortran"), "--version").splitlines()[0]
        (target / "BUNDLED.txt").write_text(
            f"Unchanged from {compiler}:\n" + "".join(f"  {name}\n" for name in libraries),
            encoding="utf-8",
        )
        output(sys.executable, "-m", "wheel", "pack", "--dest-dir", folder, content)
    return folder / wheel.name


def repair(wheel: Path, folder: str) -> None:
    """Write the wheel with its shared libraries to a folder."""
    tools = {
        "darwin": ("delocate-wheel", "-w", folder, "-v"),
        "win32": ("delvewheel", "repair", "-w", folder),
    }
    linux = (*program("auditwheel"), "repair", "-w", folder, "--plat")
    command = tools[sys.platform] if sys.platform in tools else (*linux, oldest_tag(wheel))
    output(*command, wheel)


def main(wheel: str, folder: str) -> None:
    """Repair one wheel."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        repair(Path(wheel), temporary)
        (repaired,) = Path(temporary).glob("*.whl")
        made = add_licences(repaired, target)
    print(json.dumps({"wheel": made.name, "bytes": made.stat().st_size}))


if __name__ == "__main__":
    main(*sys.argv[1:])
