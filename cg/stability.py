"""Linear stability: where a method damps y' = λ y, which is flat."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from .method import Method

__all__ = ["StabilityLimits", "stability_function", "stability_limits"]

Polynomial = tuple[Fraction, ...]
"""Coefficients, the constant first."""

_FARTHEST = 200.0
_STEP = 1e-3
_NOISE = 1e-25  # of coefficients that conditions make zero, which rounded ones leave


@dataclass(frozen=True)
class StabilityLimits:
    """How far a method is stable along two axes.

    Attributes
    ----------
    real : float
        The largest x such that ``|R(z)| ≤ 1`` for all z in [-x, 0].
    imaginary : float
        The largest y such that ``|R(iz)| ≤ 1`` for all z in [0, y].
    """

    real: float
    imaginary: float


def stability_function(method: Method) -> tuple[Polynomial, Polynomial]:
    """Return numerator and denominator of R(z): one step of ``y' = λ y`` multiplies by R(hλ).

    With the flat tableau it is ``det(I - z A + z 1 bᵀ) / det(I - z A)``.

    Parameters
    ----------
    method : Method

    Returns
    -------
    numerator, denominator : tuple of Fraction
        Coefficients, the constant first; of an explicit method the denominator is 1.

    Examples
    --------
    >>> import cg
    >>> stability_function(cg.methods["CG2"])[0]
    (Fraction(1, 1), Fraction(1, 1), Fraction(1, 2))
    """
    from flint import fmpq, fmpq_mat

    if not isinstance(method, Method):
        raise TypeError(f"method must be a Method, got {method!r}")
    a, b = method.exact
    row = [fmpq(x.numerator, x.denominator) for x in b]
    matrix = fmpq_mat([[fmpq(x.numerator, x.denominator) for x in entries] for entries in a])
    moved = matrix - fmpq_mat([row for _ in row])

    def reversed_characteristic(of: fmpq_mat) -> Polynomial:
        coefficients = [Fraction(int(x.p), int(x.q)) for x in of.charpoly().coeffs()][::-1]
        while coefficients[-1] == 0:
            coefficients.pop()
        return tuple(coefficients)

    return reversed_characteristic(moved), reversed_characteristic(matrix)


def stability_limits(method: Method) -> StabilityLimits:
    """Return how far a method is stable along the negative real and the imaginary axis.

    Parameters
    ----------
    method : Method

    Returns
    -------
    StabilityLimits
        Infinite where no end is found up to 200.

    Examples
    --------
    >>> import cg
    >>> limits = stability_limits(cg.methods["CG2"])
    >>> round(limits.real, 6), limits.imaginary
    (2.0, 0.0)
    """
    numerator, denominator = stability_function(method)
    units = [float(coefficient.unit) for coefficient in method.coefficients]
    noise = max(_NOISE, 1e4 * max(units))
    below, above = (_squared(_along(p, -1)) for p in (denominator, numerator))
    low, high = map(_squared_on_imaginary_axis, (denominator, numerator))
    return StabilityLimits(_first_negative(below, above, noise), _first_negative(low, high, noise))


def _squared_on_imaginary_axis(p: Polynomial) -> Polynomial:
    """Return ``|p(iy)|²`` as a polynomial in y."""
    even = tuple(c * (-1) ** (k // 2) if k % 2 == 0 else Fraction(0) for k, c in enumerate(p))
    odd = tuple(c * (-1) ** (k // 2) if k % 2 else Fraction(0) for k, c in enumerate(p))
    return _sum(_squared(even), _squared(odd))


def _along(p: Polynomial, direction: int) -> Polynomial:
    return tuple(c * direction**k for k, c in enumerate(p))


def _squared(p: Polynomial) -> Polynomial:
    product = [Fraction(0)] * (2 * len(p) - 1)
    for i, x in enumerate(p):
        for j, y in enumerate(p):
            product[i + j] += x * y
    return tuple(product)


def _sum(p: Polynomial, q: Polynomial) -> Polynomial:
    length = max(len(p), len(q))
    longer = [(*r, *[Fraction(0)] * (length - len(r))) for r in (p, q)]
    return tuple(x + y for x, y in zip(*longer, strict=True))


def _first_negative(denominator: Polynomial, numerator: Polynomial, noise: float) -> float:
    """Return the first x above zero from where ``denominator(x) < numerator(x)``."""
    difference = _sum(denominator, tuple(-x for x in numerator))
    sizes = _sum(tuple(map(abs, denominator)), tuple(map(abs, numerator)))
    kept = [
        0.0 if abs(c) <= noise * float(size) else float(c)
        for c, size in zip(difference, sizes, strict=True)
    ]
    while kept and kept[0] == 0.0:  # powers of x don't change the sign
        kept.pop(0)
    if not kept:
        return math.inf
    if kept[0] < 0:
        return 0.0
    coefficients = np.array(kept[::-1])

    def value(x: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return np.asarray(np.polyval(coefficients, x))

    # rounding is of the size of terms, where the sum is of the size of none of them
    grid = np.arange(0.0, _FARTHEST, _STEP)
    scale = np.polyval(np.abs(coefficients), grid)
    below = np.flatnonzero(value(grid) < -1e-12 * scale)
    if below.size == 0:
        return math.inf
    low, high = float(grid[below[0] - 1]), float(grid[below[0]])
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if value(middle) >= 0 else (low, middle)
    return low
