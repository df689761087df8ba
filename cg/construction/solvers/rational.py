"""Newton's method in rational arithmetic, with the pseudo-inverse of a double Jacobian.

A step subtracts ``correction(r(x))``, the product of J⁺ and the residuals r(x), which are exact or
nearly so. J⁺ is that of doubles and stays fixed, so that no linear algebra in fractions is needed;
each correction gains about ten digits. Corrections are rounded to multiples of ``1/grid``, so that
numerators and denominators stay short.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RationalZero:
    """The best point of a refinement, its residuals, and the number of useful corrections."""

    x: tuple[Fraction, ...]
    residuals: tuple[Fraction, ...]
    iterations: int

    @property
    def largest_residual(self) -> Fraction:
        """Magnitude of the largest residual."""
        return max(map(abs, self.residuals), default=Fraction(0))


def refine_rational(
    residuals: Callable[[Sequence[Fraction]], Sequence[Fraction]],
    x: Sequence[Fraction],
    correction: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    *,
    below: Fraction,
    grid: int,
    max_iterations: int,
) -> RationalZero:
    """Correct a point until its residuals are at most `below` or stop getting smaller.

    `correction` takes residuals in double, scaled to a maximum of 1, and returns what to subtract,
    in the same scale. Corrections are rounded to multiples of ``1/grid``.
    """
    best = RationalZero(tuple(x), tuple(residuals(x)), 0)
    largest = best.largest_residual
    while largest > below and best.iterations < max_iterations:
        scaled = np.array([float(residual / largest) for residual in best.residuals])
        trial = tuple(
            entry - Fraction(round(Fraction(move) * largest * grid), grid)
            for entry, move in zip(best.x, correction(scaled).tolist(), strict=True)
        )
        corrected = RationalZero(trial, tuple(residuals(trial)), best.iterations + 1)
        if corrected.largest_residual >= largest:
            break
        best, largest = corrected, corrected.largest_residual
    return best
