"""Checks of the parameters of problems."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.support.arrays import real_array


def vector(value: ArrayLike, name: str, n: int) -> tuple[float, ...]:
    """Return ``n`` finite numbers as floats; ValueError for any other value."""
    array = real_array(value, name)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be {n} finite numbers, got {value!r}")
    return tuple(array.tolist())


def number(value: Any, name: str) -> float:
    """Return a finite number as a float; ValueError for any other value."""
    array = real_array(value, name)
    if array.shape != () or not math.isfinite(array.item()):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return float(array.item())


def moments(value: ArrayLike) -> tuple[float, ...]:
    """Return three principal moments of inertia; ValueError if they violate the inequalities."""
    three = vector(value, "inertia", 3)
    if min(three) <= 0.0 or 2.0 * max(three) > sum(three) * (1.0 + 1e-12):
        raise ValueError(
            f"inertia must be positive, none larger than the sum of the others, got {value!r}"
        )
    return three
