"""Copies and pickles of objects with read-only arrays."""

from __future__ import annotations

from typing import Any

import numpy as np


class ReadOnly:
    """Keeps read-only arrays read-only in copies."""

    def __getstate__(self) -> dict[str, Any]:
        fixed = [
            name
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray) and not value.flags.writeable
        ]
        return {**vars(self), "fixed": fixed}

    def __setstate__(self, state: dict[str, Any]) -> None:
        fixed = state.pop("fixed")
        vars(self).update(state)
        for name in fixed:
            state[name].flags.writeable = False
