r"""Derivatives of exponential coordinates: the inverse of the differential of exp.

If :math:`y(t) = \exp(\sigma(t))\, y_0` solves :math:`y' = \sum_i f_i E_i(y)`, then

.. math::

    \sigma' = \operatorname{dexp}^{-1}_\sigma f = \sum_k \frac{B_k}{k!} \operatorname{ad}_\sigma^k f
    = f - \tfrac12 [\sigma, f] + \tfrac1{12} [\sigma, [\sigma, f]] - \dots

with the Bernoulli numbers and the bracket of `Frame.bracket`, for flows from either side. The
series converges if the powers of :math:`\operatorname{ad}_\sigma` applied to :math:`f` grow by a
factor less than :math:`2\pi`, the distance to the nearest zero of :math:`\operatorname{dexp}`;
where it diverges the results are NaN. For rotations the radius is a full turn. The result is
:math:`f` if :math:`f` and :math:`\sigma` commute.

References
----------
.. [1] A. Iserles, H. Z. Munthe-Kaas, S. P. Norsett, A. Zanna, "Lie-group methods", Acta
   Numerica 9 (2000), 215-365, section 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import NDArray

from cg.support.arrays import Array

_SMALLEST = 1e-150  # its square doesn't underflow
_RADIUS = 2.0 * math.pi
_COMMUTE = 1024.0 * np.finfo(np.float64).eps  # smaller brackets, relative to factors, are rounding
_POWERS = 20  # powers computed to estimate the growth rate, from the latter half


@cache
def bernoulli_terms(count: int) -> tuple[Fraction, ...]:
    """Return B_k / k! for k = 0, …, count."""
    terms = [Fraction(1)]
    for k in range(1, count + 1):
        terms.append(-sum((terms[j] / math.factorial(k + 1 - j) for j in range(k)), Fraction(0)))
    return tuple(terms)


def series_dexpinv(
    adjoint: Callable[[Array], Array],
    v: Array,
    order: int,
    bound: Array | None = None,
    *,
    axes: int = 1,
) -> Array:
    """Return the dexpinv series, truncated for a Runge-Kutta method of a given order.

    ``adjoint`` returns the bracket of u with its argument; v are coefficients, shape ``(...,
    dim)``, or other elements of a linear space with ``axes`` axes. Powers are taken up to
    ``order``. The order of a step needs powers up to ``order - 2``, since the coefficients of
    stages differ from multiples of u by the square of the step; but then errors of long steps
    exceed their estimates by far. The result is NaN where the infinite series diverges by
    ``bound``, shape ``(...)``, of the eigenvalues of ``adjoint``.
    """
    total, power = v, v
    terms = series_terms(order)
    for term in terms:
        power = adjoint(power)
        if term:
            total = total + term * power
    if terms and bound is not None and (far := bound >= _RADIUS).any():
        growth, commuting = _growth(adjoint, v, bound, axes)
        far = far.reshape(*far.shape, *[1] * axes)
        finite = np.isfinite(bound).reshape(far.shape)  # after overflow, growth is unknown
        sums = ~far | (finite & (growth < _RADIUS))
        total = np.where(far & finite & commuting, v, np.where(sums, total, np.nan))
    return total


def _growth(
    adjoint: Callable[[Array], Array], v: Array, bound: Array, axes: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the growth factor of high powers of `adjoint` on ``v``, and whether they commute."""
    last = tuple(range(-axes, 0))

    def size(x: Array) -> Array:
        return np.asarray(np.sqrt((np.abs(x) ** 2).sum(axis=last, keepdims=True)))

    rounding = _COMMUTE * bound.reshape(*bound.shape, *[1] * axes)
    power = v / np.maximum(size(v), _SMALLEST)
    factors = []
    for _ in range(_POWERS):
        power = adjoint(power)
        factor = size(power)
        factors.append(np.where(factor > rounding, factor, 0.0))
        power = np.where(factor > rounding, power / np.where(factor > 0.0, factor, 1.0), 0.0)
    later = factors[_POWERS // 2 :]
    return np.prod(later, axis=0) ** (1.0 / len(later)), factors[0] == 0.0


@cache
def series_terms(order: int) -> tuple[float, ...]:
    """Return the coefficients of the powers 1, 2, ... up to the last nonzero one."""
    terms = [float(term) for term in bernoulli_terms(max(order, 0))[1:]]
    while terms and not terms[-1]:
        terms.pop()
    return tuple(terms)
