"""Grids of equal steps: how many, the last one, and their times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from cg.frames.arrays import Array
from cg.integration.arguments import check_span, check_step

__all__ = ["TimeGrid", "make_grid", "stored_count"]

# A step number must be an exact float, or the times would not be distinct.
_MOST_STEPS = 2**53


@dataclass(frozen=True)
class TimeGrid:
    """Equal steps from one time to another, of which the last may be shorter.

    Attributes
    ----------
    start, stop
        The ends.
    h
        Size of the steps, with the sign of their direction.
    steps
        How many there are; none if the ends are the same.
    last
        Size of the last step, with its sign.
    """

    start: float
    stop: float
    h: float
    steps: int
    last: float

    @property
    def times(self) -> Array:
        """The times of all steps, shape ``(steps + 1,)``; they begin and end at the ends."""
        if self.steps == 0:
            return np.array([self.start])
        times: Array = self.start + self.h * np.arange(self.steps + 1, dtype=np.float64)
        times[-1] = self.stop
        return times


def make_grid(t_span: Sequence[float], h: float) -> TimeGrid:
    """Return the grid of steps of size ``h``.

    If ``h`` divides the span up to the rounding of its ends and of ``h``, all steps are equal;
    otherwise the last one is the exact rest of the span, rounded once.

    Parameters
    ----------
    t_span
        Initial and final time.
    h
        Step size, positive.

    Raises
    ------
    TypeError
        If ``h`` isn't a real number.
    ValueError
        If ``t_span`` isn't two finite numbers, or ``h`` isn't positive and finite, or so small
        that the times can't be told apart.
    """
    start, stop = check_span(t_span)
    size = check_step(h, "h")
    signed = math.copysign(size, stop - start)
    span = abs(stop - start)
    if span == 0.0:
        return TimeGrid(start, stop, signed, 0, signed)
    resolution = math.ulp(max(abs(start), abs(stop)))
    ratio = span / size
    exact = abs(Fraction(stop) - Fraction(start))
    if ratio > _MOST_STEPS or (ratio > 1.0 and size < resolution):
        raise ValueError(f"h is too small for t_span {t_span!r}: its times coincide, got {h!r}")
    # Each end carries half a unit of its rounding, the span from which an end was computed
    # another, and each step half one of h.
    slack = max(resolution, math.ulp(span)) + 0.5 * ratio * math.ulp(size)
    nearest = round(ratio)
    divides = abs(exact - nearest * Fraction(size)) <= Fraction(slack)
    steps = max(1, nearest if divides else math.ceil(ratio))
    rest = exact - (steps - 1) * Fraction(size)
    last = size if abs(rest - Fraction(size)) <= Fraction(slack) else float(rest)
    return TimeGrid(start, stop, signed, steps, math.copysign(last, signed))


def stored_count(steps: int, every: int) -> int:
    """Return how many points are kept of so many steps: the first, every k-th, and the last."""
    return len(range(0, steps, every)) + 1
