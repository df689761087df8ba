"""Caches of functions of one argument, by its identity or by its value."""

import weakref
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, TypeVar

Keyed = TypeVar("Keyed")
Result = TypeVar("Result")

_MAX_VALUES = 64


def cached_by_identity(compute: Callable[[Keyed], Result]) -> Callable[[Keyed], Result]:
    """Return a function that computes its value once for each object.

    The key is the identity, since to hash all coefficients of a method takes longer than most
    computations. The cache keeps no object alive.
    """
    values: dict[int, Result] = {}

    @wraps(compute)
    def recall(argument: Keyed) -> Result:
        key = id(argument)
        if key not in values:
            values[key] = compute(argument)
            weakref.finalize(argument, values.pop, key, None)
        return values[key]

    return recall


def cached_by_value(compute: Callable[[Keyed], Result]) -> Callable[[Keyed], Result]:
    """Return a function that keeps its last 64 results, for arguments that can be hashed.

    The object of the call before is recognised without its hash.
    """
    results = lru_cache(maxsize=_MAX_VALUES)(compute)
    last: tuple[Any, Any] = (results, None)  # an argument that can be hashed, and its result

    @wraps(compute)
    def recall(argument: Keyed) -> Result:
        nonlocal last
        before, result = last
        if argument is not before:
            try:
                hash(argument)
            except TypeError:
                return compute(argument)
            result = results(argument)
            last = argument, result
        return result  # type: ignore[no-any-return]

    return recall
