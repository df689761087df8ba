"""Checks of arguments that several modules share."""

from __future__ import annotations

import operator
from typing import Any

__all__ = ["check_integer"]


def check_integer(name: str, value: Any, least: int) -> int:
    """Return `value` as an int.

    Raises
    ------
    TypeError
        If it isn't an integer; the message names the argument.
    ValueError
        If it is less than `least`.
    """
    try:
        checked = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {value!r}") from None
    if checked < least:
        raise ValueError(f"{name} must be at least {least}, got {value}")
    return checked
