"""Reservation of memory for compiled calls.

A failed ``allocate`` in Fortran stops the program, and so does an automatic array. The memory of a
call follows from its arguments, and is compared here with the available memory.
"""

from __future__ import annotations

import threading

import numpy as np

from .checks import total_memory
from .forks import at_forks

__all__ = ["reserved"]

_SLACK = 1 << 20  # f2py's and the allocator's own

_changed = threading.Condition()
_promised = {"bytes": 0}  # to calls that are running


def _forget_promises() -> None:
    global _promised  # noqa: PLW0603
    _promised = {"bytes": 0}


at_forks(_changed, _forget_promises)


class reserved:
    """Run a compiled call only if the memory that it allocates can be had.

    Calls in other threads that leave too little are waited for.

    Parameters
    ----------
    needed : int
        Bytes, no fewer than the call allocates at any one time.
    what : str
        What is asked for, for the message.

    Raises
    ------
    MemoryError
        If there is less: of physical memory, or below the limits of the process.
    """

    def __init__(self, needed: int, what: str) -> None:
        self._needed = needed
        self._what = what

    def __enter__(self) -> None:
        needed = self._needed
        self._promised = promised = _promised  # a child of a fork has another
        with _changed:
            while not _available(needed + promised["bytes"] + _SLACK):
                if not promised["bytes"]:
                    raise MemoryError(
                        f"{self._what} needs {_in_words(needed)} of memory, which isn't there"
                    )
                _changed.wait()
            promised["bytes"] += needed

    def __exit__(self, *_: object) -> None:
        with _changed:
            self._promised["bytes"] -= self._needed
            _changed.notify_all()


def _available(needed: int) -> bool:
    if needed > total_memory():
        return False
    try:
        np.empty(needed, dtype=np.uint8)  # asks for addresses; untouched, it takes no memory
    except (MemoryError, ValueError):  # ValueError: beyond all addresses
        return False
    return True


def _in_words(needed: int) -> str:
    if needed >= 1 << 30:
        return f"{needed / 2**30:.3g} GiB"
    return f"{needed / 2**20:.3g} MiB"
