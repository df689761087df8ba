"""Vector spaces, manifolds on which groups act, and frames that users have written."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np

from cg import frames
from cg.frames.facts import facts_of
from cg.frames.matrix_functions import newton_schulz
from cg.frames.stiefel import min_norm_generator
from cg.jax.entire_functions import angle_over_sine, power_series
from cg.jax.groups import functions_of, make_series_dexpinv
from cg.jax.matrices import expm, projection
from cg.jax.rules import (
    JaxArray,
    Rules,
    adjoint,
    column_error,
    length_error,
    linear,
    real_dtype,
    same,
    unit_step,
    with_identity_derivative,
)

_SERIES_TERMS = 18  # terms of (exp(a) - 1) / a for |a| < 1; the next one is below rounding


def euclidean_rules(frame: frames.Euclidean) -> Rules:
    """Return the rules of a vector space."""
    return Rules(
        frame, lambda v, y: y + v, log=lambda y0, y1: y1 - y0, dexpinv=lambda u, v, order: v,
        closed_coefficients=lambda y, tangent: tangent, unequal_sizes=jnp.abs,
    )  # fmt: skip


def sphere_rules(frame: frames.Sphere) -> Rules:
    """Return the rules of a sphere."""
    group = functions_of(frame.group)

    def turn(start: JaxArray, end: JaxArray) -> JaxArray:
        wedge = jnp.outer(end, start)
        return projection(frame.group, wedge - wedge.T)

    def log(y0: JaxArray, y1: JaxArray) -> JaxArray:
        cosine = y0 @ y1
        vector = turn(y0, y1 - jnp.where(cosine < 0.0, -1.0, 1.0) * y0)
        return angle_over_sine(vector @ vector, cosine) * vector

    return Rules(
        frame, lambda v, y: group.exponential(v) @ y, unit_step, log, group.dexpinv, turn,
        relative_error=length_error, unique=False,
    )  # fmt: skip


def stiefel_rules(frame: frames.Stiefel) -> Rules:
    """Return the rules of matrices with orthonormal columns."""
    group = functions_of(frame.group)
    return Rules(
        frame, lambda v, y: group.exponential(v) @ y, newton_schulz, dexpinv=group.dexpinv,
        closed_coefficients=lambda y, x: projection(frame.group, min_norm_generator(y, x)),
        relative_error=column_error, unique=False,
    )  # fmt: skip


def conjugation_rules(frame: frames.Grassmann | frames.SPD | frames.IsospectralOrbit) -> Rules:
    """Return the rules of matrices on which a group acts from both sides."""
    group, spd = functions_of(frame.group), isinstance(frame, frames.SPD)

    def flow(v: JaxArray, y: JaxArray) -> JaxArray:
        x = group.exponential(v)
        return x @ y @ adjoint(x)

    def restore(y: JaxArray) -> JaxArray:
        y = 0.5 * (y + adjoint(y))
        if isinstance(frame, frames.Grassmann):
            return 3.0 * (y @ y) - 2.0 * (y @ y @ y)
        if isinstance(frame, frames.SPD):
            return y
        vectors = jnp.linalg.eigh(y)[1]
        return (vectors * jnp.asarray(frame.spectrum, real_dtype(y))) @ adjoint(vectors)

    def relative_error(y: JaxArray) -> JaxArray:
        values, asymmetry = jnp.linalg.eigvalsh(y), jnp.abs(y - adjoint(y)).max()
        if isinstance(frame, frames.SPD):
            return jnp.maximum(asymmetry, -values[0]) / jnp.abs(y).max()
        spectrum = frame._eigenvalues
        error = jnp.maximum(0.5 * asymmetry, jnp.abs(values - spectrum).max())
        return error / (np.abs(spectrum).max() or 1.0)

    def geodesic(y0: JaxArray, y1: JaxArray) -> JaxArray:
        return 0.5 * group.log1p(jnp.linalg.solve(y0, y1 - y0).mT)

    def composed(flows: JaxArray) -> JaxArray:
        first = group.exponential(flows[0])
        product, _ = jax.lax.scan(lambda x, v: (group.exponential(v) @ x, None), first, flows[1:])
        return group.log1p(product - jnp.eye(len(product)))

    orbit, in_python = isinstance(frame, frames.IsospectralOrbit), frame.compiled_blocks() is None
    near = with_identity_derivative(restore) if orbit else restore
    return Rules(
        frame, flow, near, dexpinv=group.dexpinv, relative_error=relative_error, unique=False,
        first_coordinates=geodesic if spd else None, composed=composed if in_python else None,
    )  # fmt: skip


def hyperbolic_rules(frame: frames.Hyperbolic) -> Rules:
    """Return the rules of the half-space with dilations and translations."""

    def flow(v: JaxArray, y: JaxArray) -> JaxArray:
        shift = jnp.append(_expm1_quotient(v[0]) * v[1:], 0.0)
        return jnp.exp(v[0]) * y + shift.astype(y.dtype)

    def log(y0: JaxArray, y1: JaxArray) -> JaxArray:
        change = y1 - y0
        growth = change[-1] / y0[-1]
        a = jnp.log1p(growth)
        return jnp.append(a, (change[:-1] - growth * y0[:-1]) / _expm1_quotient(a))

    def coefficients(y: JaxArray, tangent: JaxArray) -> JaxArray:
        a = tangent[-1] / y[-1]
        return jnp.append(a, tangent[:-1] - a * y[:-1])

    def sizes(y: JaxArray) -> JaxArray:
        return jnp.full(frame.n, jnp.sqrt(y @ y)).at[0].set(1.0)

    return Rules(
        frame, flow, same, log, make_series_dexpinv(frame), coefficients, sizes,
        relative_error=lambda y: jnp.where(y[-1] > 0.0, 0.0, 1.0 - y[-1]),
    )  # fmt: skip


def _expm1_quotient(a: JaxArray) -> JaxArray:
    """Return (exp(a) - 1) / a."""
    near = jnp.abs(a) < 1.0
    small, large = jnp.where(near, a, 0.0), jnp.where(near, 1.0, a)
    terms = tuple(1.0 / math.factorial(k) for k in range(1, _SERIES_TERMS + 1))
    return jnp.where(near, power_series(terms, small), jnp.expm1(large) / large)


def user_rules(frame: frames.FieldFrame | frames.MatrixFrame | frames.LinearAction) -> Rules:
    """Return the rules of a frame whose functions the user has written in jax.numpy."""
    if isinstance(frame, frames.FieldFrame):
        flow = frame._flow
    else:
        matrices = frame.matrices if isinstance(frame, frames.MatrixFrame) else frame.dense()

        def flow(v: JaxArray, y: JaxArray) -> JaxArray:
            return expm(linear(v, matrices)) @ y

    restore = frame._functions.get("restore", same)
    log = frame._functions.get("exp_coordinates")
    dexpinv = make_series_dexpinv(frame) if facts_of(frame).has_brackets else None
    return Rules(frame, flow, restore, log, dexpinv, unique=False)
