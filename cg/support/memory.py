"""Reservation of memory for compiled calls.

A failed ``allocate`` in Fortran stops the program, and so does an automatic array. The memory of a
call follows from its arguments, and is compared here with the available memory.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from cg.support.checks import total_memory
from cg.support.parallel import at_forks

_SLACK = 1 << 20  # memory of f2py and of the allocator

_changed = threading.Condition()
_in_use = {"bytes": 0}  # memory of calls that are running


def _forget_calls() -> None:
    global _in_use  # noqa: PLW0603
    _in_use = {"bytes": 0}


at_forks(_changed, _forget_calls)


@contextmanager
def reserved(needed: int, what: str) -> Iterator[None]:
    """Reserve memory for a compiled call; wait while calls in other threads leave too little.

    `needed` bounds the bytes that it allocates at any one time; `what` names it in messages.
    """
    in_use = _in_use  # a forked child replaces the global one
    with _changed:
        while not _available(needed + in_use["bytes"] + _SLACK):
            if not in_use["bytes"]:
                size = f"{needed / 2**30:.3g} GiB" if needed >> 30 else f"{needed / 2**20:.3g} MiB"
                raise MemoryError(f"{what} needs {size} of memory, which is not available")
            _changed.wait()
        in_use["bytes"] += needed
    try:
        yield
    finally:
        with _changed:
            in_use["bytes"] -= needed
            _changed.notify_all()


def _available(needed: int) -> bool:
    """Return whether a number of bytes can be allocated."""
    if needed > total_memory():
        return False
    try:
        np.empty(needed, dtype=np.uint8)  # reserves addresses; untouched, it takes no memory
    except (MemoryError, ValueError):  # ValueError: beyond all addresses
        return False
    return True
