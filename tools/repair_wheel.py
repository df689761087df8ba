"""Add shared libraries and their licences to a wheel, and set its platform tag.

``python tools/repair_wheel.py WHEEL FOLDER`` runs auditwheel and adds the licences to its result.
"""

from __future__ import annotations

import json
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


def oldest_tag(wheel: Path) -> str:
    """Return the oldest platform that the wheel runs on once its libraries are in it."""
    report = output(sys.executable, "-m", "auditwheel", "show", wheel)
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
        libraries = sorted(path.name for path in content.glob("*.libs/*"))
        target = information / "licenses" / "bundled"
        target.mkdir(parents=True, exist_ok=True)
        for name in BUNDLED:
            shutil.copy(LICENCES / name, target)
        compiler = output("gfortran", "--version").splitlines()[0]
        (target / "BUNDLED.txt").write_text(
            f"Unchanged from {compiler}:\n" + "".join(f"  {name}\n" for name in libraries),
            encoding="utf-8",
        )
        output(sys.executable, "-m", "wheel", "pack", "--dest-dir", folder, content)
    return folder / wheel.name


def main(wheel: str, folder: str) -> None:
    """Repair one wheel."""
    source, target = Path(wheel), Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    tag = oldest_tag(source)
    with tempfile.TemporaryDirectory() as temporary:
        output(sys.executable, "-m", "auditwheel", "repair", "--plat", tag, "-w", temporary, source)
        (repaired,) = Path(temporary).glob("*.whl")
        made = add_licences(repaired, target)
    print(json.dumps({"tag": tag, "wheel": made.name, "bytes": made.stat().st_size}))


if __name__ == "__main__":
    main(*sys.argv[1:])
