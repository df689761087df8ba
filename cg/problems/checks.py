"""Checks of the parameters of problems."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, real_array
from cg.problems.taylor import Term
from cg.support.balls import to_ball


def vector(value: ArrayLike, name: str, n: int) -> tuple[float, ...]:
    """Return ``n`` finite numbers; ValueError if ``value`` is anything else."""
    array = real_array(value, name)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be {n} finite numbers, got {value!r}")
    return tuple(array.tolist())


def number(value: Any, name: str, *, positive: bool = False) -> float:
    """Return a finite number; ValueError if ``value`` is anything else, or not positive."""
    array = real_array(value, name)
    if array.shape != () or not math.isfinite(array.item()):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    if positive and array.item() <= 0.0:
        raise ValueError(f"{name} must be positive, got {value!r}")
    return float(array.item())


def moments(value: ArrayLike, name: str = "inertia") -> tuple[float, ...]:
    """Return three principal moments of inertia; ValueError if no body has these."""
    three = vector(value, name, 3)
    if min(three) <= 0.0 or 2.0 * max(three) > sum(three) * (1.0 + 1e-12):
        raise ValueError(
            f"{name} must be positive, none larger than the sum of the others, got {value!r}"
        )
    return three


def times_array(t: ArrayLike) -> Array:
    """Return finite times as an array; ValueError if ``t`` is anything else."""
    times = real_array(t, "t")
    if not np.isfinite(times).all():
        raise ValueError(f"t must be finite, got {t!r}")
    return times


def ball(x: float) -> arb:
    """Return a float as an exact ball."""
    return to_ball(Fraction(float(x)))


def cross_terms(
    x: Sequence[int], y: Sequence[int], scale: Sequence[arb], sign: int = 1
) -> list[tuple[Term, ...]]:
    """Return the terms of ``sign * x cross (scale * y)``, for unknowns given by their indices."""
    rows: list[tuple[Term, ...]] = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rows.append(((sign * scale[k], (x[j], y[k])), (-sign * scale[j], (x[k], y[j]))))
    return rows
