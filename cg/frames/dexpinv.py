r"""Derivatives of exponential coordinates: the inverse of the differential of exp.

If :math:`y(t) = \exp(\sigma(t))\, y_0` solves :math:`y' = \sum_i f_i E_i(y)`, then

.. math::

    \sigma' = \operatorname{dexp}^{-1}_\sigma f = \sum_k \frac{B_k}{k!} \operatorname{ad}_\sigma^k f
    = f - \tfrac12 [\sigma, f] + \tfrac1{12} [\sigma, [\sigma, f]] - \dots

with the numbers of Bernoulli and the bracket of `Frame.bracket`, whichever side flows act from.
The series converges for :math:`f` if its powers grow by less than :math:`2\pi` each, the distance
to the nearest zero of :math:`\operatorname{dexp}`; where they grow faster, results are NaN.
Rotations reach this radius after a full turn.  What commutes with :math:`\sigma` is left as it is.

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

from cg.frames.arrays import Array, Points
from cg.frames.rotations import half_angle

__all__ = [
    "bernoulli_terms",
    "frobenius",
    "motion_dexpinv",
    "rotation_dexpinv",
    "series_dexpinv",
]

_SERIES_BELOW = 1.0  # of the square of an angle; above, nothing cancels that matters
_SERIES_TERMS = 12
_SMALLEST = 1e-150  # its square doesn't underflow
_RADIUS = 2.0 * math.pi
_COMMUTE = 16.0 * np.finfo(np.float64).eps  # brackets so small beside their factors are rounding
_POWERS = 20  # of which the growth of the latter half is that of all further ones


@cache
def bernoulli_terms(count: int) -> tuple[Fraction, ...]:
    """Return B_k / k! for k = 0, …, count."""
    terms = [Fraction(1)]
    for k in range(1, count + 1):
        terms.append(-sum((terms[j] / math.factorial(k + 1 - j) for j in range(k)), Fraction(0)))
    return tuple(terms)


def frobenius(matrices: Points) -> Array:
    """Return the root of the sum of squares of entries of matrices, shape ``(...)``."""
    return np.asarray(np.sqrt((matrices.real**2 + matrices.imag**2).sum(axis=(-2, -1))))


def series_dexpinv(
    adjoint: Callable[[Array], Array],
    v: Array,
    order: int,
    bound: Array | None = None,
    *,
    axes: int = 1,
) -> Array:
    """Return the series as far as a Runge-Kutta method of an order needs it.

    Parameters
    ----------
    adjoint
        Brackets of the point of the algebra with coefficients.
    v
        Coefficients, shape ``(..., dim)``, or other members of a linear space.
    order
        Powers up to ``order - 2`` count: coefficients of stages differ from multiples of the
        point of the algebra by the square of a step.
    bound
        What no eigenvalue of `adjoint` exceeds, shape ``(...)``; None to sum where the series
        diverges, too.
    axes
        How many of the last axes make one member.

    Returns
    -------
    ndarray
        The sum, NaN where it would be of a series that diverges.
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
        finite = np.isfinite(bound).reshape(far.shape)  # nothing is known of what overflows
        sums = ~far | (finite & (growth < _RADIUS))
        total = np.where(far & finite & commuting, v, np.where(sums, total, np.nan))
    return total


def _growth(
    adjoint: Callable[[Array], Array], v: Array, bound: Array, axes: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Return by how much high powers of `adjoint` grow on ``v``, and whether the first is 0."""
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
    """Return the factors of the powers from the first one to the last one that isn't zero."""
    terms = [float(term) for term in bernoulli_terms(max(order - 2, 0))[1:]]
    while terms and not terms[-1]:
        terms.pop()
    return tuple(terms)


def rotation_dexpinv(u: Array, v: Array, sign: float) -> Array:
    r"""Return the sum of the series where the bracket is plus or minus the cross product.

    It is :math:`v \mp \tfrac12 u \times v + (1 - x \cot x)\, n \times (n \times v)`,
    :math:`x = |u| / 2`, :math:`n = u / |u|`.
    """
    half, sinc = half_angle(u)
    once = np.cross(u, v)
    factor = _second(half, sinc)[..., None]
    found = np.asarray(v - (0.5 * sign) * once + factor * np.cross(u, once))
    return _beyond_a_turn(found, half, u, v, once)


def motion_dexpinv(u: Array, v: Array, sign: float) -> Array:
    r"""Return the sum of the series for a rotation and any number of vectors that it turns.

    Parameters
    ----------
    u, v
        Shape ``(..., 3 + 3 k)``: the coefficients of the rotation, then the vectors.
    sign
        1 if flows act from the left, -1 if from the right.

    Notes
    -----
    With :math:`\theta` the angle, :math:`\operatorname{ad} (\operatorname{ad}^2 + \theta^2)^2 = 0`.
    So the series is :math:`1 - \tfrac12 \operatorname{ad} + a \operatorname{ad}^2 + b
    \operatorname{ad}^4`, with the value and the derivative of the series at the eigenvalues
    :math:`\pm i\theta`.
    """
    half, _ = half_angle(u[..., :3])
    second, fourth = _motion_factors(2.0 * half)
    powers = [v]
    for _ in range(4):
        powers.append(sign * motion_bracket(u, powers[-1]))
    found = np.asarray(
        v - 0.5 * powers[1] + second[..., None] * powers[2] + fourth[..., None] * powers[4]
    )
    return _beyond_a_turn(found, half, u, v, powers[1])


def _beyond_a_turn(found: Array, half: Array, u: Array, v: Array, once: Array) -> Array:
    """Return `found`, and after a turn or more ``v`` where it commutes with ``u``, else NaN."""
    beyond = half >= 0.5 * _RADIUS
    if not beyond.any():
        return found
    lengths = [np.linalg.norm(x, axis=-1) for x in (u, v, once)]
    bound = _COMMUTE * lengths[0] * lengths[1]
    apart = ~(np.isfinite(bound) & (lengths[2] <= bound))  # nothing is known of what overflows
    return np.where(beyond[..., None], np.where(apart[..., None], np.nan, v), found)


def motion_bracket(u: Array, v: Array) -> Array:
    """Return the commutator of a rotation with vectors that it turns; see `motion_dexpinv`."""
    u, v = np.broadcast_arrays(u, v)
    parts = [np.cross(u[..., :3], v[..., :3])]
    for k in range(3, u.shape[-1], 3):
        part = slice(k, k + 3)
        parts.append(np.cross(u[..., :3], v[..., part]) - np.cross(v[..., :3], u[..., part]))
    return np.concatenate(parts, axis=-1)


def _second(half: Array, sinc: Array) -> Array:
    """Return (1 - x cot x) / (2 x)^2, whose rounding is small beside what it is multiplied by."""
    twice = np.maximum(2.0 * half, _SMALLEST)
    return np.asarray((1.0 - np.cos(half) / sinc) / (twice * twice))


def _motion_factors(angle: Array) -> tuple[Array, Array]:
    """Return the factors a and b of `motion_dexpinv`."""
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
