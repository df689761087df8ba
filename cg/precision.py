"""The precision of balls, which python-flint keeps once for the whole process."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["working_precision"]

_lock = threading.RLock()


@contextmanager
def working_precision(bits: int) -> Iterator[None]:
    """Set the precision of balls; computations in other threads that set it too wait.

    Parameters
    ----------
    bits : int
        Of the midpoints.
    """
    from flint import ctx

    with _lock:
        before = ctx.prec
        ctx.prec = bits
        try:
            yield
        finally:
            ctx.prec = before
