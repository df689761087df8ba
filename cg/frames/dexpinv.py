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

from cg.frames.rotations import half_angle
from cg.support.arrays import Array

_SERIES_BELOW = 1.0  # largest squared angle for which series replace formulas that cancel
_SERIES_TERMS = 12
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
    terms = _series_terms(order)
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
def _series_terms(order: int) -> tuple[float, ...]:
    """Return the coefficients of the powers 1, 2, ... up to the last nonzero one."""
    terms = [float(term) for term in bernoulli_terms(max(order, 0))[1:]]
    while terms and not terms[-1]:
        terms.pop()
    return tuple(terms)


def rotation_dexpinv(u: Array, v: Array, sign: float) -> Array:
    r"""Return dexpinv where the bracket is plus or minus the cross product.

    It is :math:`v \mp \tfrac12 u \times v + (1 - x \cot x)\, n \times (n \times v)`,
    :math:`x = |u| / 2`, :math:`n = u / |u|`.
    """
    half, sinc = half_angle(u)
    once = np.cross(u, v)
    factor = _second_coefficient(half, sinc)[..., None]
    result = np.asarray(v - (0.5 * sign) * once + factor * np.cross(u, once))
    return _check_radius(result, half, u, v, once)


def motion_dexpinv(u: Array, v: Array, sign: float) -> Array:
    r"""Return dexpinv for a rotation group acting on k vectors, as in SE(3) for k = 1.

    ``u`` and ``v``, shape ``(..., 3 + 3 k)``, are the coefficients of the rotation, then of the
    vectors; ``sign`` is 1 if flows act from the left, -1 if from the right. With :math:`\theta` the
    angle, :math:`\operatorname{ad} (\operatorname{ad}^2 + \theta^2)^2 = 0`. So the sum is :math:`1
    - \tfrac12 \operatorname{ad} + a \operatorname{ad}^2 + b \operatorname{ad}^4`, with a and b such
    that it has the value and the derivative of the series at the eigenvalues :math:`\pm i\theta`.
    """
    half, _ = half_angle(u[..., :3])
    second, fourth = _motion_coefficients(2.0 * half)
    powers = [v]
    for _ in range(4):
        powers.append(sign * motion_bracket(u, powers[-1]))
    result = np.asarray(
        v - 0.5 * powers[1] + second[..., None] * powers[2] + fourth[..., None] * powers[4]
    )
    return _check_radius(result, half, u, v, powers[1])


def _check_radius(result: Array, half: Array, u: Array, v: Array, once: Array) -> Array:
    """Return `result`; for angles of a turn or more ``v`` if it commutes with ``u``, else NaN."""
    beyond = half >= 0.5 * _RADIUS
    if not beyond.any():
        return result
    lengths = [np.linalg.norm(x, axis=-1) for x in (u, v, once)]
    bound = _COMMUTE * lengths[0] * lengths[1]
    commute = np.isfinite(bound) & (lengths[2] <= bound)
    return np.where(beyond[..., None], np.where(commute[..., None], v, np.nan), result)


def motion_bracket(u: Array, v: Array) -> Array:
    """Return the bracket of the semidirect product of rotations and k vectors."""
    u, v = np.broadcast_arrays(u, v)
    parts = [np.cross(u[..., :3], v[..., :3])]
    for k in range(3, u.shape[-1], 3):
        part = slice(k, k + 3)
        parts.append(np.cross(u[..., :3], v[..., part]) - np.cross(v[..., :3], u[..., part]))
    return np.concatenate(parts, axis=-1)


def _second_coefficient(half: Array, sinc: Array) -> Array:
    """Return (1 - x cot x) / (2 x)^2; it loses digits for small x, where its term is small."""
    twice = np.maximum(2.0 * half, _SMALLEST)
    return np.asarray((1.0 - np.cos(half) / sinc) / (twice * twice))


def _motion_coefficients(angle: Array) -> tuple[Array, Array]:
    """Return the coefficients a and b of `motion_dexpinv`."""
    square = angle * angle
    terms = [float(term) for term in bernoulli_terms(2 * _SERIES_TERMS + 2)[2::2]]
    # G(s) = sum of terms[k] s^(k + 1) at s = -angle^2; a and b from G and its derivative there
    s = -np.minimum(square, _SERIES_BELOW)
    near_second, near_fourth = np.zeros_like(s), np.zeros_like(s)
    for k in range(_SERIES_TERMS, 0, -1):
        near_second = (near_second + (1 - k) * terms[k]) * s
        near_fourth = near_fourth * s + k * terms[k]
    near_second += terms[0]
    far = np.maximum(square, _SERIES_BELOW)
    half = 0.5 * np.sqrt(far)
    sine = np.sin(half)
    cotangent = half * np.cos(half) / sine
    value = (1.0 - cotangent) / far
    slope = ((half / sine) ** 2 - cotangent) / (2.0 * far)
    fourth = (value - slope) / far
    second = value + fourth * far
    small = square < _SERIES_BELOW
    return np.where(small, near_second, second), np.where(small, near_fourth, fourth)
