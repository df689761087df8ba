"""The memory of the machine, and a check that there is enough of it for a compiled call.

A failed ``allocate`` in Fortran stops the program, and so does an automatic array. The memory of a
call follows from its arguments, and is compared here with the available memory.
"""

import math
import os

import numpy as np

_SLACK = 1 << 20  # memory of f2py and of the allocator


def total_memory() -> float:
    """Return the bytes of memory of the machine, infinity if they are unknown."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf


def check_memory(needed: int, label: str) -> None:
    """Raise MemoryError unless a compiled call that allocates so many bytes can be made.

    `needed` bounds the bytes that it allocates at any one time; `label` names it in messages.
    """
    try:
        if needed + _SLACK > total_memory():
            raise MemoryError
        np.empty(needed + _SLACK, dtype=np.uint8)  # untouched, it reserves addresses alone
    except (MemoryError, ValueError):  # ValueError: beyond all addresses
        size = f"{needed / 2**30:.3g} GiB" if needed >> 30 else f"{needed / 2**20:.3g} MiB"
        raise MemoryError(f"{label} needs {size} of memory, which is not available") from None
