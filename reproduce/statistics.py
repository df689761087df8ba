"""Median and quartiles."""

from collections.abc import Sequence

import numpy as np


def quartiles(values: Sequence[float]) -> list[float] | None:
    """Return minimum, quartiles and maximum, or None if there are no values.

    The results are values of the sample: f spans many powers of ten, so interpolation between
    neighbours would be meaningless.
    """
    if not values:
        return None
    five: list[float] = np.quantile(values, (0, 0.25, 0.5, 0.75, 1), method="nearest").tolist()
    return five


def median(values: Sequence[float]) -> float:
    """Return the median, as defined by `quartiles`; ValueError if there are no values."""
    five = quartiles(values)
    if five is None:
        raise ValueError("values must not be empty")
    return five[2]
