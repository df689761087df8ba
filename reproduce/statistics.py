"""The one median, and the quartiles beside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["median", "quartiles"]


def quartiles(values: Sequence[float]) -> list[float] | None:
    """Return minimum, quartiles and maximum, or None where there are no values.

    They are values that occur, since f spans many powers of ten, between which there is nothing
    to interpolate.
    """
    if not values:
        return None
    found: list[float] = np.quantile(values, (0, 0.25, 0.5, 0.75, 1), method="nearest").tolist()
    return found


def median(values: Sequence[float]) -> float:
    """Return the median as `quartiles` has it.

    Raises
    ------
    ValueError
        If there are no values.
    """
    found = quartiles(values)
    if found is None:
        raise ValueError("there is no median of no values")
    return found[2]
