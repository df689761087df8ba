"""Linear stability: where a method damps y' = λ y, which is flat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any

from ..support.balls import to_flint, to_fraction
from .method import Method

if TYPE_CHECKING:
    from flint import acb, fmpq, fmpq_poly

__all__ = ["StabilityLimits", "stability_function", "stability_limits", "too_large"]

Polynomial = tuple[Fraction, ...]
"""Coefficients, the constant first."""

_MAX_WORK = 5e9
"""Of exact polynomials, s⁴ times the bits of the coefficients and some more: 2 to 15 seconds."""

_NOISE = 10**4  # last places of coefficients, which rounding them can change sums of products by
_GROWTH = Fraction(
    1, 10**12
)  # of |R|² beyond one, where rounded coefficients make a maximum of one exceed it
_APART = 1e-13  # the relative distance of roots that doubles can tell apart


@dataclass(frozen=True)
class StabilityLimits:
    """How far a method is stable along two axes.

    Attributes
    ----------
    real : float
        The largest x such that ``|R(z)| ≤ 1`` for all z in [-x, 0].
    imaginary : float
        The largest y such that ``|R(iz)| ≤ 1`` for all z in [0, y].

    Both are infinite where there is no end, and NaN where they weren't computed.
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
    from flint import fmpq_mat

    _check(method)
    a, b = method.exact
    row = list(map(to_flint, b))
    matrix = fmpq_mat([list(map(to_flint, entries)) for entries in a])
    moved = matrix - fmpq_mat([row for _ in row])

    def reversed_characteristic(of: fmpq_mat) -> Polynomial:
        coefficients = list(map(to_fraction, of.charpoly().coeffs()))[::-1]
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
        NaN for methods whose exact polynomials are too large: see `too_large`.

    Notes
    -----
    The limits are roots of ``|D|² - |N|²`` with R = N / D, which are isolated with certainty: no
    root is missed, whatever the number of stages. Coefficients of a method that are rounded
    decimals leave residuals in the order conditions. They are removed, since the sign of the
    smallest one would decide whether the method is stable near the origin.

    Examples
    --------
    >>> import cg
    >>> limits = stability_limits(cg.methods["CG2"])
    >>> round(limits.real, 6), limits.imaginary
    (2.0, 0.0)
    """
    if too_large(method):
        return StabilityLimits(math.nan, math.nan)
    numerator, denominator = stability_function(method)
    unit = max(coefficient.unit for coefficient in method.coefficients)
    if unit:
        numerator = _of_order(numerator, denominator, method.order)
    n, d = _reduced(numerator, denominator)
    noise, growth = to_flint(_NOISE * unit), to_flint(_GROWTH if unit else Fraction(0))
    back_n, back_d, sizes_n, sizes_d = _mirrored(n), _mirrored(d), _sizes(n), _sizes(d)
    # as |D|² - |N|² factors on the real axis, half the degree is enough
    sizes = sizes_n + sizes_d
    factors = [_certain(back_d - back_n, sizes, noise), _certain(back_d + back_n, sizes, noise)]
    real = _end(factors, back_d * back_d, growth)
    below, above = _on_imaginary_axis(d, -1), _on_imaginary_axis(n, -1)
    sizes = _on_imaginary_axis(sizes_d, 1) + _on_imaginary_axis(sizes_n, 1)
    square = _end([_certain(below - above, sizes, noise)], below, growth)
    return StabilityLimits(real, math.sqrt(square))


def too_large(method: Method) -> str | None:
    """Return why the limits of stability of a method aren't computed; None if they are.

    The work grows with the fourth power of the stages and with the bits of a coefficient over the
    common denominator. At the bound it takes 2 to 15 seconds, with 60 stages of rationals of six
    digits it would take a minute.

    Parameters
    ----------
    method : Method
    """
    _check(method)
    (a, b), s = method.exact, method.stages
    denominator, size = 1, 0
    for x in chain(*a, b):
        denominator = math.lcm(denominator, x.denominator)
        size = max(size, x.numerator.bit_length() - x.denominator.bit_length())
        bits = denominator.bit_length()
        if s**4 * (bits + size + 8) > _MAX_WORK:
            return (
                f"limits of stability, since with {s} stages and a common denominator of {bits} "
                "bits or more the exact polynomials would take too long"
            )
    return None


def _check(method: object) -> None:
    if not isinstance(method, Method):
        raise TypeError(f"method must be a Method, got {method!r}")


def _of_order(numerator: Polynomial, denominator: Polynomial, order: int) -> Polynomial:
    """Return the numerator without what rounded coefficients leave in the order conditions.

    A method of order p has ``N(z) = D(z) exp(z) + O(z^{p+1})``: of an explicit one the
    coefficients through the order are 1/k!. With decimals of 36 places they differ from that by
    1e-36 or so, and `|N(iy)|² - |D(iy)|²`, which begins with the power p + 1 or p + 2, has tiny
    coefficients of lower powers. Near the origin these are larger than all others.
    """
    exact = [
        sum((d / math.factorial(k - j) for j, d in enumerate(denominator[: k + 1])), Fraction(0))
        for k in range(min(order + 1, len(numerator)))
    ]
    return (*exact, *numerator[len(exact) :])


def _reduced(numerator: Polynomial, denominator: Polynomial) -> tuple[fmpq_poly, fmpq_poly]:
    from flint import fmpq_poly

    n, d = fmpq_poly(list(map(to_flint, numerator))), fmpq_poly(list(map(to_flint, denominator)))
    common = n.gcd(d)
    return n // common, d // common


def _mirrored(p: fmpq_poly) -> fmpq_poly:
    """Return p(-x)."""
    return type(p)([-c if k % 2 else c for k, c in enumerate(p.coeffs())])


def _sizes(p: fmpq_poly) -> fmpq_poly:
    return type(p)([abs(c) for c in p.coeffs()])


def _on_imaginary_axis(p: fmpq_poly, sign: int) -> fmpq_poly:
    """Return ``|p(iy)|²`` as a polynomial in y², or with all signs positive."""
    make, coefficients = type(p), p.coeffs()
    even, odd = (
        make([c * sign**k for k, c in enumerate(coefficients[start::2])]) for start in (0, 1)
    )
    return even * even + make([0, 1]) * odd * odd


def _certain(p: fmpq_poly, sizes: fmpq_poly, noise: fmpq) -> fmpq_poly:
    """Return p without the lowest and highest powers whose coefficients are noise.

    The lowest tell the sign near zero, the highest tell it at infinity. Their sizes are those of
    the sums that they are, with all terms positive.
    """
    coefficients = p.coeffs()
    sure = [k for k, c in enumerate(coefficients) if abs(c) > noise * sizes[k]]
    if not sure:
        return type(p)([])
    inside = range(sure[0], sure[-1] + 1)
    return type(p)([c if k in inside else 0 for k, c in enumerate(coefficients)])


def _end(factors: Sequence[fmpq_poly], below: fmpq_poly, growth: fmpq) -> float:
    """Return from where above zero a product is negative; by little compared to ``below``."""
    if not all(factors):
        return math.inf
    roots = sorted(
        float(root.real)
        for factor in factors
        for root in _roots(factor)
        if root.imag == 0 and root.real > 0
    )
    if math.prod(_sign(next(filter(None, factor.coeffs()))) for factor in factors) < 0:
        return 0.0
    for left, right in pairwise(roots):
        if right - left > _APART * right:
            middle = to_flint(Fraction((left + right) / 2))
            value = math.prod((factor(middle) for factor in factors), start=to_flint(Fraction(1)))
            if value < -growth * below(middle):
                return left
    return (
        roots[-1] if math.prod(_sign(factor.coeffs()[-1]) for factor in factors) < 0 else math.inf
    )


def _roots(p: fmpq_poly) -> list[acb]:
    """Return the roots of a polynomial; those that are real have no imaginary part at all."""
    found: list[Any] = p.numer().complex_roots()  # with their multiplicities
    return [root for root, _ in found]


def _sign(number: fmpq) -> int:
    return (number > 0) - (number < 0)
