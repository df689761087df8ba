"""Processor, system and versions on which the numbers depend, without names of machines."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import subprocess
from pathlib import Path

_PACKAGES = ("numpy", "scipy")


def describe() -> dict[str, str]:
    """Return the processor, the system, and the versions of compilers and packages."""
    environment = {
        "processor": _processor(), "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(), "gfortran": _version("gfortran"),
        "gcc": _version("gcc"),
    }  # fmt: skip
    for package in _PACKAGES:
        try:
            environment[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            environment[package] = "absent"
    return environment


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or "unknown"
    match = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return match[1].strip() if match else platform.machine()


def _version(compiler: str) -> str:
    try:
        answer = subprocess.run(
            [compiler, "-dumpfullversion"], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "absent"
    return answer.stdout.strip()
