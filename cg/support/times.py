"""Times in messages, and times that lie at the end of a span up to rounding."""

from __future__ import annotations

import math

import numpy as np

from cg.support.arrays import Array

ROUNDINGS = 4
"""How many roundings beyond its ends a span admits: those of a few sums."""


def apart(*numbers: float) -> list[str]:
    """Return numbers for a message, with six digits or as many as tell them apart.

    A number alone, or equal ones, have all their digits.

    Examples
    --------
    >>> apart(0.5, 2.0), apart(1.7e9, 1.7e9 + 0.01)
    (['0.5', '2'], ['1700000000', '1700000000.01'])
    """
    if len(set(numbers)) == 1:
        return [repr(float(number)) for number in numbers]
    for digits in range(6, 18):
        texts = [f"{number:.{digits}g}" for number in numbers]
        if len(set(texts)) == len(set(numbers)):
            break
    return texts


def clipped(times: Array, low: float, high: float) -> tuple[Array, int | None]:
    """Return times moved to the ends of a span that they are beyond by a few roundings.

    The second result is the place of the first time farther beyond or NaN, None if there is none.
    """
    ends = [abs(end) for end in (low, high) if math.isfinite(end)]
    beyond = ROUNDINGS * math.ulp(max(ends, default=0.0))
    outside = ~((times >= low - beyond) & (times <= high + beyond))  # also NaN
    place = int(np.argmax(outside)) if outside.any() else None
    return np.clip(times, low, high), place
