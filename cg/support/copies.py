"""Copies and pickles of objects with read-only arrays, and objects made without their class."""

from typing import Any, TypeVar

import numpy as np

Result = TypeVar("Result")


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


def filled(kind: type[Result], fields: dict[str, Any]) -> Result:
    """Return an object of a frozen dataclass with all its fields, much faster than by its class."""
    record = object.__new__(kind)
    vars(record).update(fields)
    return record
