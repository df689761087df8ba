"""Checks of arguments that several modules share."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np

__all__ = ["LARGEST_COUNT", "check_integer"]

LARGEST_COUNT = 2**31 - 1
"""Counts cross into Fortran as integers of 32 bits."""


def check_integer(name: str, value: Any, least: int, most: int | None = None) -> int:
    """Return `value` as an int.

    Raises
    ------
    TypeError
        If it isn't an integer; the message names the argument.
    ValueError
        If it is less than `least`, or more than `most`.
    """
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        checked = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {value!r}") from None
    if checked < least:
        raise ValueError(f"{name} must be at least {least}, got {value}")
    if most is not None and checked > most:
        raise ValueError(f"{name} must be at most {most}, got {value}")
    return checked
