"""The inverse of the derivative of the exponential, by closed forms and by its series."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from cg.frames import Frame
from cg.frames.dexpinv import bernoulli_terms
from cg.jax.entire import JaxArray, dexpinv_factor, motion_factors
from cg.jax.rules import linear

__all__ = ["motion_dexpinv", "series_dexpinv", "turning_dexpinv"]

_RADIUS = (2.0 * math.pi) ** 2  # of the series of dexpinv, squared
_COMMUTE = 16.0
_POWERS = 20  # of which the latter half shows how all further ones grow


def turning_dexpinv(side: float) -> Callable[[JaxArray, JaxArray, int], JaxArray]:
    """Return dexpinv where brackets are plus or minus the cross product."""

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        q = u @ u
        once = jnp.cross(u, v)
        value = v - (0.5 * side) * once + dexpinv_factor(_within(q)) * jnp.cross(u, once)
        return _beyond_a_turn(value, q, v, once)

    return dexpinv


def motion_dexpinv(u: JaxArray, v: JaxArray, side: float) -> JaxArray:
    """Return dexpinv of motions and of vectors that rotate with them."""
    omega, turned = u[:3], u.reshape(-1, 3)

    def bracket(w: JaxArray) -> JaxArray:
        parts = w.reshape(-1, 3)
        moved = jnp.cross(omega, parts) - jnp.cross(parts[0], turned)
        return side * jnp.concatenate([jnp.cross(omega, parts[0]), moved[1:].reshape(-1)])

    q = omega @ omega
    second, fourth = motion_factors(_within(q))
    once = bracket(v)
    twice = bracket(once)
    value = v - 0.5 * once + second * twice + fourth * bracket(bracket(twice))
    return _beyond_a_turn(value, q, v, once)


def _within(q: JaxArray) -> JaxArray:
    return jnp.where(q < _RADIUS, q, 0.0)


def _beyond_a_turn(value: JaxArray, q: JaxArray, v: JaxArray, once: JaxArray) -> JaxArray:
    """Return `value`, and after a turn or more ``v`` where it commutes, else NaN."""
    bound = (_COMMUTE * jnp.finfo(q.dtype).eps) ** 2 * q
    commutes = (bound * v * v - once * once).sum() >= 0.0  # one kernel of XLA
    after = jnp.where(commutes, v, jnp.nan)
    return jnp.where(q < _RADIUS, value, after)


def series_dexpinv(frame: Frame) -> Callable[[JaxArray, JaxArray, int], JaxArray]:
    """Return dexpinv by its series as far as a method of an order needs it.

    It is NaN where the series to infinite order diverges, as in `cg.frames.dexpinv`.
    """
    constants = frame._adjoint_basis

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        terms = [float(term) for term in bernoulli_terms(max(order - 2, 0))[1:]]
        while terms and not terms[-1]:
            terms.pop()
        if not terms:
            return v
        matrix = linear(u, constants)
        total = power = v
        for term in terms:
            power = power @ matrix
            if term:
                total = total + term * power
        return _where_it_converges(matrix, v, total)

    return dexpinv


def _where_it_converges(matrix: JaxArray, v: JaxArray, total: JaxArray) -> JaxArray:
    """Return a sum of the series of dexpinv, ``v`` if that commutes, NaN where it diverges."""
    matrix, fixed = jax.lax.stop_gradient((matrix, v))
    bound = jnp.sqrt((matrix**2).sum())
    rounding = _COMMUTE * jnp.finfo(bound.dtype).eps * bound

    def growth() -> tuple[JaxArray, JaxArray]:
        def multiply(power: JaxArray, _: Any) -> tuple[JaxArray, JaxArray]:
            power = power @ matrix
            factor = jnp.sqrt(power @ power)
            kept = factor > rounding
            power = jnp.where(kept, power / jnp.where(kept, factor, 1.0), 0.0)
            return power, jnp.where(kept, factor, 0.0)

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
