"""Unit quaternions, and exponentials and logarithms of rotations of space."""

from __future__ import annotations

import jax.numpy as jnp

from cg.frames import UnitQuaternion
from cg.frames.quaternion import _generators
from cg.jax.dexpinv import turning_dexpinv
from cg.jax.entire import JaxArray, rotation_vector, stumpff
from cg.jax.rules import Rules, bilinear, length_error, turned, unit_step


def quaternion_rules(frame: UnitQuaternion) -> Rules:
    """Return the rules of unit quaternions."""
    generators = _generators(frame.convention, frame.scalar_first)

    def flow(v: JaxArray, y: JaxArray) -> JaxArray:
        # By scalars, as in `sines`, steps that an adjoint repeats differ by rounding.
        x2 = 0.25 * (v @ v)
        return stumpff(0, x2) * y + stumpff(1, x2) * turned(v, generators, y)

    def sines(y: JaxArray, end: JaxArray) -> JaxArray:
        return jnp.stack(bilinear(2.0 * generators, list(end), list(y)))

    def log(y0: JaxArray, y1: JaxArray) -> JaxArray:
        return rotation_vector(sines(y0, y1 - y0), y0 @ y1)

    def coefficients(y: JaxArray, tangent: JaxArray) -> JaxArray:
        return 2.0 * sines(y, tangent)

    dexpinv = turning_dexpinv(frame._rotation_sign)
    return Rules(frame, flow, unit_step, log, dexpinv, coefficients, distance=length_error)


def rotation_matrix(v: JaxArray, wedge: JaxArray, average: int = 0) -> JaxArray:
    """Return the rotation by v, whose skew matrix is `wedge`.

    With ``average=1`` it is the integral of the rotation by s v over s from 0 to 1.
    """
    q = v @ v
    unit, once, twice = (stumpff(average + k, q) for k in range(3))
    return unit * jnp.eye(3, dtype=v.dtype) + (once * wedge + twice * jnp.outer(v, v))


def quaternion_of(away: JaxArray) -> JaxArray:
    """Return the unit quaternion (x, y, z, w), w ≥ 0, of the rotation identity plus `away`."""
    trace = jnp.trace(away)
    axial = jnp.stack([away[2, 1] - away[1, 2], away[0, 2] - away[2, 0], away[1, 0] - away[0, 1]])
    block = away + away.T + jnp.diag(-trace * jnp.ones(3, away.dtype))
    outer = jnp.block([[block, axial[:, None]], [axial[None, :], (4.0 + trace)[None, None]]])
    q = outer[jnp.argmax(jnp.diagonal(outer))]
    q = q / jnp.sqrt(q @ q)
    return jnp.where(q[3] < 0.0, -q, q)


def rotation_logarithm(away: JaxArray) -> JaxArray:
    """Return the rotation vector of the identity plus `away`, as `cg.frames.rotations` has it."""
    q = quaternion_of(away)
    return rotation_vector(q[:3], q[3])
