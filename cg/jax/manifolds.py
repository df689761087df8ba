"""Vector spaces, spheres, Stiefel manifolds, and frames that users have written."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cg.frames import Euclidean, FieldFrame, LinearAction, MatrixFrame, Sphere, Stiefel
from cg.integration.step.plan import has_brackets
from cg.jax.dexpinv import series_dexpinv
from cg.jax.entire import JaxArray, angle_over_sine
from cg.jax.groups import exponential_of, group_dexpinv
from cg.jax.matrices import expm, projection
from cg.jax.rules import Rules, linear, newton_schulz, ones, real_dtype, same, unit_step


def euclidean_rules(frame: Euclidean) -> Rules:
    """Return the rules of a vector space."""
    return Rules(
        frame,
        lambda v, y: y + v,
        same,
        lambda y0, y1: y1 - y0,
        lambda u, v, order: v,
        lambda y, tangent: tangent,
        jnp.abs,
    )


def sphere_rules(frame: Sphere) -> Rules:
    """Return the rules of a sphere."""
    group = frame.group
    exponential = exponential_of(group)

    def turn(start: JaxArray, end: JaxArray) -> JaxArray:
        wedge = jnp.outer(end, start)
        return projection(group, wedge - wedge.T)

    def log(y0: JaxArray, y1: JaxArray) -> JaxArray:
        cosine = y0 @ y1
        vector = turn(y0, y1 - jnp.where(cosine < 0.0, -1.0, 1.0) * y0)
        return angle_over_sine(vector @ vector, cosine) * vector

    return Rules(
        frame,
        lambda v, y: exponential(v) @ y,
        unit_step,
        log,
        group_dexpinv(group),
        turn,
        ones(frame),
        free=False,
    )


def stiefel_rules(frame: Stiefel) -> Rules:
    """Return the rules of matrices with orthonormal columns."""
    group = frame.group
    exponential = exponential_of(group)

    def coefficients(y: JaxArray, tangent: JaxArray) -> JaxArray:
        mixed = y.T @ tangent
        along = 0.5 * (mixed - mixed.T)
        left = (tangent - y @ mixed + 0.5 * (y @ along)) @ y.T
        return projection(group, left - left.T)

    return Rules(
        frame,
        lambda v, y: exponential(v) @ y,
        newton_schulz,
        None,
        group_dexpinv(group),
        coefficients,
        ones(frame),
        free=False,
    )


def own_rules(frame: FieldFrame | MatrixFrame | LinearAction) -> Rules:
    """Return the rules of a frame whose functions the user has written in jax.numpy."""
    functions = frame._functions
    if isinstance(frame, FieldFrame):
        flow = frame._flow
    else:
        matrices = frame.matrices if isinstance(frame, MatrixFrame) else frame.dense()

        def flow(v: JaxArray, y: JaxArray) -> JaxArray:
            return expm(linear(v, matrices)) @ y

    def coefficients(y: JaxArray, tangent: JaxArray) -> JaxArray:
        eye = jnp.eye(frame.dim, dtype=real_dtype(y))
        columns = jax.vmap(lambda v: rules.field(v, y).reshape(-1))(eye)
        flat = tangent.reshape(-1)
        if jnp.iscomplexobj(columns):
            columns = jnp.concatenate([columns.real, columns.imag], axis=1)
            flat = jnp.concatenate([flat.real, flat.imag])
        return flat @ jnp.linalg.pinv(columns)

    rules = Rules(
        frame,
        flow,
        functions.get("restore", same),
        functions.get("exp_coordinates"),
        series_dexpinv(frame) if has_brackets(frame) else None,
        coefficients,
        ones(frame),
        free=False,
    )
    return rules
