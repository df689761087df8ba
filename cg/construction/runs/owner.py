"""The process that carries out a run, and whether it is still running."""

import json
import os
import secrets
import socket
import time
from pathlib import Path

_SILENT_SECONDS = 60  # after which a run on another machine counts as ended

ACTIVE_OWNERS: set[str] = set()
"""Owners of the runs that this process is carrying out."""


def new_owner() -> str:
    """Return a text that identifies this process and one run in it."""
    return json.dumps(
        {
            "machine": socket.gethostname(),
            "process": os.getpid(),
            "began": _start_time(os.getpid()),
            "token": secrets.token_hex(8),
        }
    )


def is_active(owner: str, changed: float) -> bool:
    """Return whether the process of a run, given by `new_owner`, is still carrying it out.

    The time since the run last `changed` decides where processes can't be looked up: on other
    machines, and on Windows, where a signal of 0 would end the process.
    """
    identity = json.loads(owner)
    if identity["machine"] != socket.gethostname() or os.name == "nt":
        return owner in ACTIVE_OWNERS or time.time() - changed < _SILENT_SECONDS
    process = int(identity["process"])
    if process == os.getpid():
        return owner in ACTIVE_OWNERS
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return bool(identity["began"] == _start_time(process))


def _start_time(process: int) -> int | None:
    """Return when a process began, in clock ticks; None where the system doesn't report it."""
    try:
        return int(Path(f"/proc/{process}/stat").read_text("utf-8").rsplit(")", 1)[1].split()[19])
    except (OSError, IndexError, ValueError):
        return None
