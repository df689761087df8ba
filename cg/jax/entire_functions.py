r"""Functions of squared angles that are smooth at zero, in any precision and to any derivative.

They are functions of :math:`q = |v|^2`, which is smooth at zero where :math:`|v|` is not.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from numpy.polynomial import Chebyshev, Polynomial

from cg.frames.algebra import bernoulli_terms
from cg.jax.rules import JaxArray

_STUMPFF_NEAR = 4.0  # below it the series of stumpff is summed, since the recurrence would cancel
_STUMPFF_TERMS = 10  # the next term of the series is below rounding
_ROOT_NEAR, _ROOT_TERMS = 0.01, 5  # the same for cosine and sin(x) / x, which don't cancel
_POLES = (2.0 * math.pi) ** 2, (4.0 * math.pi) ** 2  # the two poles of dexpinv_factor nearest to 0
_FACTOR_SERIES = [  # coefficients of the series in q of dexpinv_factor without these two poles
    float(abs(term)) - sum(2.0 / pole ** (n + 1) for pole in _POLES)
    for n, term in enumerate(bernoulli_terms(32)[2::2])
]
# A polynomial interpolates the powers from the third on up to the pole, with fewer terms
_FACTOR_REST = Chebyshev.interpolate(Polynomial(_FACTOR_SERIES[3:]), 7, [0.0, _POLES[0]])
_FACTOR_TERMS = (*_FACTOR_SERIES[:3], *_FACTOR_REST.convert(kind=Polynomial).coef.tolist())
_ARCTAN_NEAR = 0.04  # below it the series of arctan is summed
_ARCTAN_SERIES = tuple(1.0 / (2 * j + 1) for j in range(15))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def power_series(coefficients: tuple[float, ...], x: JaxArray) -> JaxArray:
    """Return the polynomial with some coefficients, the constant first, by Horner's rule."""
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = coefficient + x * total
    return total


@power_series.defjvp
def _power_series_jvp(coefficients: tuple[float, ...], primals: Any, tangents: Any) -> Any:
    # Differentiating Horner's rule takes twice the operations; its transpose stores each of them.
    (x,), (dx,) = primals, tangents
    slope = tuple(k * c for k, c in enumerate(coefficients))[1:]
    return power_series(coefficients, x), power_series(slope or (0.0,), x) * dx


def stumpff(k: int, q: JaxArray) -> JaxArray:
    r"""Return Stumpff's function :math:`c_k(q) = \sum_j (-q)^j / (2 j + k)!` for real q ≥ 0.

    :math:`c_0(x^2) = \cos x`, :math:`c_1(x^2) = \sin(x) / x`, and :math:`c_{k+2} = (1 / k! - c_k) /
    q` (Stumpff, *Himmelsmechanik*, vol. 1, 1959, section 41).
    """
    return _stumpff_sum(((k, 1.0),), jnp.asarray(q))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _stumpff_sum(weights: tuple[tuple[int, float], ...], q: JaxArray) -> JaxArray:
    r"""Return the sum of Stumpff's functions with weights, given as pairs (k, weight).

    The derivative is :math:`c_k' = \tfrac12 (k\, c_{k+2} - c_{k+1})`: derivatives of such sums are
    such sums, and none of them is a quotient of small numbers. A sum takes one series, as each of
    its functions would.
    """
    # Reverse mode in a loop differentiates this code, not by the rule below, a second time: cosine
    # and sin(x) / x are a short series near zero, where the root has no derivative.
    cancels = max(k for k, _ in weights) > 1
    limit, count = (_STUMPFF_NEAR, _STUMPFF_TERMS) if cancels else (_ROOT_NEAR, _ROOT_TERMS)
    near, far = jnp.minimum(q, limit), jnp.maximum(q, limit)
    terms = tuple(sum(w / math.factorial(2 * j + k) for k, w in weights) for j in range(count + 1))
    series = power_series(terms, -near)
    root = jnp.sqrt(far)
    functions = [jnp.cos(root), jnp.sin(root) / root]
    for k in range(max(k for k, _ in weights) - 1):
        functions.append((1.0 / math.factorial(k) - functions[k]) / far)
    return jnp.where(q < limit, series, sum(w * functions[k] for k, w in weights))


@_stumpff_sum.defjvp
def _stumpff_sum_jvp(weights: tuple[tuple[int, float], ...], primals: Any, tangents: Any) -> Any:
    (q,), (dq,) = primals, tangents
    slope: dict[int, float] = {}
    for k, w in weights:
        slope[k + 1] = slope.get(k + 1, 0.0) - 0.5 * w
        slope[k + 2] = slope.get(k + 2, 0.0) + 0.5 * k * w
    terms = tuple((k, w) for k, w in sorted(slope.items()) if w)
    if len(terms) == 1:
        ((k, w),) = terms
        return _stumpff_sum(weights, q), w * stumpff(k, q) * dq
    return _stumpff_sum(weights, q), _stumpff_sum(terms, q) * dq


def dexpinv_factor(q: JaxArray) -> JaxArray:
    r"""Return :math:`(1 - x \cot x) / (4 x^2)` with :math:`q = (2 x)^2 < 4 \pi^2`, 1/12 at zero.

    It multiplies :math:`\operatorname{ad}^2` in the inverse of the derivative of a rotation's
    exponential; see ``fortran/frames/algebra.f90``. It is :math:`\sum_k 2 / (4 k^2 \pi^2 -
    q)`; the terms from the third on are summed as a series in q.
    """
    near, far = _POLES[0] - q, _POLES[1] - q
    return 2.0 * (near + far) / (near * far) + power_series(_FACTOR_TERMS, q)


def motion_factors(q: JaxArray) -> tuple[JaxArray, JaxArray]:
    r"""Return the factors a and b of dexpinv for rigid motions, with :math:`q = \theta^2`.

    With g(q) the `dexpinv_factor` they are :math:`b = -g'(q)` and :math:`a = g(q) + q\, b`.
    """
    value, slope = jax.jvp(dexpinv_factor, (q,), (jnp.ones_like(q),))
    return value - q * slope, -slope


def angle_over_sine(q: JaxArray, c: JaxArray) -> JaxArray:
    r"""Return :math:`\operatorname{atan2}(\sqrt q, c) / \sqrt q`, which is 1/c at q = 0 < c.

    With :math:`r = \sqrt{q + c^2}` and :math:`t = \sqrt q / (c + r)` the angle is 2 arctan(t); it
    is halved once more, so that the argument of the arc tangent is below one. There is no value
    at the angle π.
    """
    r = jnp.sqrt(q + c * c)
    obtuse = c < 0.0
    total = jnp.where(obtuse, q / jnp.where(obtuse, r - c, 1.0), c + r)  # c + r, no cancellation
    t2 = q / (total * total)
    halving = 1.0 + jnp.sqrt(1.0 + t2)
    return 4.0 * _arctan_quotient(t2 / (halving * halving)) / (total * halving)


def rotation_vector(vector: JaxArray, scalar: JaxArray) -> JaxArray:
    """Return the v of length at most 2 π with exp(v/2) = (vector, scalar), a unit quaternion.

    As in `cg.frames.rotations` the axis of the quaternion -1, which is not unique, is the first
    one; derivatives, which do not exist there, are zero.
    """
    square = vector @ vector
    opposite = (square == 0.0) & (scalar < 0.0)
    turn = jnp.zeros_like(vector).at[0].set(2.0 * math.pi)
    angle = angle_over_sine(square, jnp.where(opposite, 1.0, scalar))
    return jnp.where(opposite, turn, 2.0 * angle * vector)


def _arctan_quotient(x: JaxArray) -> JaxArray:
    """Return arctan(√x) / √x."""
    near = jnp.minimum(x, _ARCTAN_NEAR)
    series = power_series(_ARCTAN_SERIES, -near)
    root = jnp.sqrt(jnp.maximum(x, _ARCTAN_NEAR))
    return jnp.where(x < _ARCTAN_NEAR, series, jnp.arctan(root) / root)
