"""Who is at work on a run, and whether that process lives."""

from __future__ import annotations

import json
import os
import secrets
import socket
import time
from pathlib import Path

__all__ = ["AT_WORK", "alive", "owner"]

_SILENT_SECONDS = 60  # after which a run on another machine is taken to have ended

AT_WORK: set[str] = set()
"""Owners of this process that are at work."""


def owner() -> str:
    """Return what tells this process, and this run in it, from others."""
    return json.dumps(
        {
            "machine": socket.gethostname(),
            "process": os.getpid(),
            "began": _began(os.getpid()),
            "token": secrets.token_hex(8),
        }
    )


def alive(text: str, changed: float) -> bool:
    """Return whether the process that a run belongs to is still at work on it."""
    said = json.loads(text)
    # on Windows a signal of 0 would end the process
    if said["machine"] != socket.gethostname() or os.name == "nt":
        return text in AT_WORK or time.time() - changed < _SILENT_SECONDS
    process = int(said["process"])
    if process == os.getpid():
        return text in AT_WORK
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return bool(said["began"] == _began(process))


def _began(process: int) -> int | None:
    """Return when a process began, in ticks of the system's clock, where that can be told."""
    try:
        return int(Path(f"/proc/{process}/stat").read_text("utf-8").rsplit(")", 1)[1].split()[19])
    except (OSError, IndexError, ValueError):
        return None
