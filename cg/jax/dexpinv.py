r"""dexpinv, the inverse of the derivative of the exponential: closed forms and the series.

With the bracket :math:`\operatorname{ad}_u v` and Bernoulli's numbers it is :math:`\sum_k B_k / k!
\operatorname{ad}_u^k v`, see `cg.frames.dexpinv`. Where brackets are plus or minus the cross
product with :math:`q = |u|^2` it is

.. math:: v \mp \tfrac12 u \times v + g(q)\, u \times (u \times v),

with `dexpinv_factor` g, and on rigid motions :math:`v - \tfrac12 \operatorname{ad}_u v + a(q)
\operatorname{ad}_u^2 v + b(q) \operatorname{ad}_u^4 v` with `motion_factors` a and b. As in
NumPy the value is NaN where the infinite series diverges, though only a few of its terms are
summed, and v where u and v commute.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp

from cg.frames import Frame
from cg.frames.dexpinv import series_terms
from cg.jax.entire import JaxArray, dexpinv_factor, motion_factors
from cg.jax.rules import Dexpinv, cross, dot, linear

_RADIUS = (2.0 * math.pi) ** 2  # radius of the series of dexpinv, squared
_COMMUTE = 1024.0  # roundings: a smaller bracket, relative to its factors, counts as zero
_POWERS = 20  # powers of ad_u, of which the latter half gives the rate of growth


def motion_dexpinv(side: float) -> Dexpinv:
    """Return dexpinv of rotations and of any vectors that rotate with them.

    Where brackets are plus or minus the cross product alone, a closed form without `motion_factors`
    and the fourth power of ad takes fewer operations.
    """

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        x, y = list(u), list(v)
        omega = x[:3]

        def bracket(w: list[JaxArray]) -> list[JaxArray]:
            value = cross(omega, w[:3])
            for k in range(3, len(w), 3):
                parts = cross(omega, w[k : k + 3]), cross(x[k : k + 3], w[:3])
                value += [a + b for a, b in zip(*parts, strict=True)]
            return value

        q = dot(omega, omega)
        within = jnp.where(q < _RADIUS, q, 0.0)  # so that unused values have finite derivatives
        once = bracket(y)
        twice = bracket(once)
        factors, brackets = [-0.5 * side], [once, twice]
        if len(x) == 3:
            factors.append(dexpinv_factor(within))
        else:
            factors.extend(motion_factors(within))
            brackets.append(bracket(bracket(twice)))
        value = [a + dot(factors, row) for a, *row in zip(y, *brackets, strict=True)]
        bound = (_COMMUTE * jnp.finfo(q.dtype).eps) ** 2 * q
        commutes = bound * dot(y, y) >= dot(once, once)
        return jnp.where(q < _RADIUS, jnp.stack(value), jnp.where(commutes, v, jnp.nan))

    return dexpinv


def series_dexpinv(frame: Frame) -> Dexpinv:
    """Return the series of dexpinv as far as an order needs it, NaN where it diverges."""
    constants = frame._adjoint_basis

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        terms = series_terms(order)
        if not terms:
            return v
        matrix = linear(u, constants)
        total = power = v
        for term in terms:
            power = power @ matrix
            if term:
                total = total + term * power
        return _if_convergent(matrix, v, total)

    return dexpinv


def _if_convergent(matrix: JaxArray, v: JaxArray, total: JaxArray) -> JaxArray:
    """Return ``total``, the sum of the series; ``v`` if u commutes; NaN where it diverges.

    It diverges if powers of the matrix of ad_u applied to v grow by 2 π or more each. The rate is
    at most the Frobenius norm ``bound``; the powers are computed where that is larger than 2 π.
    """
    matrix, fixed = jax.lax.stop_gradient((matrix, v))
    bound = jnp.sqrt((matrix**2).sum())
    rounding = _COMMUTE * jnp.finfo(bound.dtype).eps * bound

    def growth() -> tuple[JaxArray, JaxArray]:
        def multiply(power: JaxArray, _: Any) -> tuple[JaxArray, JaxArray]:
            power = power @ matrix
            factor = jnp.sqrt(power @ power)
            significant = factor > rounding
            power = jnp.where(significant, power / jnp.where(significant, factor, 1.0), 0.0)
            return power, jnp.where(significant, factor, 0.0)

        size = jnp.sqrt(fixed @ fixed)
        unit = fixed / jnp.where(size > 0.0, size, 1.0)
        factors = jax.lax.scan(multiply, unit, None, length=_POWERS)[1]
        later = factors[_POWERS // 2 :]
        return jnp.prod(later) ** (1.0 / len(later)), factors[0] == 0.0

    def near() -> tuple[JaxArray, JaxArray]:
        return jnp.zeros_like(bound), jnp.zeros((), bool)

    rate, commuting = jax.lax.cond(bound * bound >= _RADIUS, growth, near)
    # An infinite bound says nothing about eigenvalues.
    converges = jnp.isfinite(bound) & (rate * rate < _RADIUS)
    return jnp.where(commuting & jnp.isfinite(bound), v, jnp.where(converges, total, jnp.nan))
