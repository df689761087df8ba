"""Copies and pickles of objects with read-only arrays, and values cached by object."""

import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import numpy as np

Keyed = TypeVar("Keyed")
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


def cached(compute: Callable[[Keyed], Result]) -> Callable[[Keyed], Result]:
    """Return a function that computes its value once for each object.

    The key is the identity, since to hash all coefficients of a method takes longer than most
    computations. The cache keeps no object alive.
    """
    values: dict[int, Result] = {}

    @wraps(compute)
    def recall(one: Keyed) -> Result:
        key = id(one)
        if key not in values:
            values[key] = compute(one)
            weakref.finalize(one, values.pop, key, None)
        return values[key]

    return recall
