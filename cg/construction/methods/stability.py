"""Linear stability, which is that of the flat tableau: where flows commute, a method is classical.

Limits are roots of exact polynomials.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from cg.construction.methods.method import Method
from cg.support.checks import check_instance
from cg.support.quads import to_flint, to_fraction

if TYPE_CHECKING:
    from cg.support.flint import fmpq, fmpq_poly

Polynomial = tuple[Fraction, ...]
"""Coefficients, the constant first."""

_MAX_STAGES = 60  # exact polynomials take the fourth power of the stages in time
_NOISE = 10**4  # effect of rounded coefficients on sums of products, in units of their last places
_GROWTH = Fraction(1, 10**12)  # tolerated |R|² - 1 of methods with rounded coefficients


@dataclass(frozen=True)
class StabilityLimits:
    """Stability limits of a method; infinite if the interval is unbounded, NaN if not computed."""

    real: float  # largest x such that |R(z)| ≤ 1 for all z in [-x, 0]
    imaginary: float  # largest y such that |R(iz)| ≤ 1 for all z in [0, y]


def stability_function(method: Method) -> tuple[Polynomial, Polynomial]:
    """Return numerator and denominator of the stability function R(z), constant coefficients first.

    With the flat tableau, ``R(z) = det(I - z A + z 1 bᵀ) / det(I - z A)``.
    """
    check_instance("method", method, Method)
    numerator, denominator = _stability_polynomials(method)
    above, below = (tuple(map(to_fraction, p.coeffs())) for p in (numerator, denominator))
    return above, below


def _stability_polynomials(method: Method) -> tuple[fmpq_poly, fmpq_poly]:
    from cg.support.flint import fmpq_mat, fmpq_poly

    a, b = method.exact
    row = list(map(to_flint, b))
    matrix = fmpq_mat([list(map(to_flint, entries)) for entries in a])
    matrices = matrix - fmpq_mat([row for _ in row]), matrix
    numerator, denominator = (fmpq_poly(m.charpoly().coeffs()[::-1]) for m in matrices)
    return numerator, denominator


def stability_limits(method: Method) -> StabilityLimits:
    """Return the stability limits of a method on the negative real and the imaginary axis.

    They are roots of ``|D|² - |N|²`` with R = N / D, isolated rigorously, so that none is missed.
    Where coefficients are rounded, its lowest powers may be rounding noise, whose sign would decide
    whether the method is stable near the origin; they are set to zero.
    """
    if reason_without_limits(method):
        return StabilityLimits(math.nan, math.nan)
    n, d = _stability_polynomials(method)
    common = n.gcd(d)
    n, d = n // common, d // common
    unit = max(coefficient.unit for coefficient in method.coefficients)
    noise, growth = to_flint(_NOISE * unit), to_flint(_GROWTH if unit else Fraction(0))
    make = type(n)
    sizes_n, sizes_d = (make([abs(c) for c in p.coeffs()]) for p in (n, d))
    minus = make([0, -1])
    back_n, back_d = n(minus), d(minus)
    # on the real axis D² - N² = (D - N) (D + N), factors of half the degree
    sizes = sizes_n + sizes_d
    factors = [_certain(back_d - back_n, sizes, noise), _certain(back_d + back_n, sizes, noise)]
    real = _end(factors, back_d * back_d, growth)
    below, above = _on_imaginary_axis(d, -1), _on_imaginary_axis(n, -1)
    sizes = _on_imaginary_axis(sizes_d, 1) + _on_imaginary_axis(sizes_n, 1)
    square = _end([_certain(below - above, sizes, noise)], below, growth)
    return StabilityLimits(real, math.sqrt(square))


def reason_without_limits(method: Method) -> str | None:
    """Return why the stability limits of a method aren't computed; None if they are."""
    if method.stages <= _MAX_STAGES:
        return None
    return (
        f"limits of stability, since the exact polynomials of {method.stages} stages are too long"
    )


def _on_imaginary_axis(p: fmpq_poly, sign: int) -> fmpq_poly:
    """Return ``|p(iy)|²`` as a polynomial in y², or with all signs positive."""
    make, coefficients = type(p), p.coeffs()
    even, odd = (
        make([c * sign**k for k, c in enumerate(coefficients[start::2])]) for start in (0, 1)
    )
    return even * even + make([0, 1]) * odd * odd


def _certain(p: fmpq_poly, sizes: fmpq_poly, noise: fmpq) -> fmpq_poly:
    """Return p without the lowest and highest powers whose coefficients are rounding noise.

    Their signs decide near zero and at infinity. `sizes` has sums of the magnitudes of all terms.
    """
    coefficients = p.coeffs()
    significant = [k for k, c in enumerate(coefficients) if abs(c) > noise * sizes[k]]
    if not significant:
        return type(p)([])
    inside = range(significant[0], significant[-1] + 1)
    return type(p)([c if k in inside else 0 for k, c in enumerate(coefficients)])


def _end(factors: Sequence[fmpq_poly], below: fmpq_poly, growth: fmpq) -> float:
    """Return the point above zero from which a product of factors is below ``-growth * below``."""
    if not all(factors):
        return math.inf
    # pairs of a root, a ball, and its multiplicity; real roots have imaginary part 0 exactly
    pairs: list[Any] = [pair for factor in factors for pair in factor.numer().complex_roots()]
    roots = sorted(float(root.real) for root, _ in pairs if root.imag == 0 and root.real > 0)
    if math.prod(next(filter(None, factor.coeffs())) for factor in factors) < 0:
        return 0.0
    for left, right in pairwise(roots):
        if right > left:
            middle = to_flint((Fraction(left) + Fraction(min(right, sys.float_info.max))) / 2)
            if math.prod(factor(middle) for factor in factors) < -growth * below(middle):
                return left
    at_infinity = math.prod(factor.coeffs()[-1] for factor in factors)
    return roots[-1] if at_infinity < 0 else math.inf
