"""Errors on their way from other processes."""

from __future__ import annotations

import pickle

__all__ = ["portable"]


def portable(error: Exception) -> Exception:
    """Return an error, or what tells of it if another process couldn't make it again.

    Classes of errors whose constructors take something else than their message can be pickled, but
    not unpickled, and the process that is sent one takes its worker for dead.
    """
    try:
        if type(pickle.loads(pickle.dumps(error))) is type(error):
            return error
    except Exception:  # whatever the class does
        pass
    return RuntimeError(f"{type(error).__module__}.{type(error).__qualname__}: {error}")
