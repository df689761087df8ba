"""Matrix groups."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from cg.frames import SL, SO, SU, Frame, MatrixGroup, Semidirect, Sp, U
from cg.jax.dexpinv import motion_dexpinv, series_dexpinv, turning_dexpinv
from cg.jax.entire import JaxArray, dexpinv_factor, rotation_vector, stumpff
from cg.jax.matrices import expm, logarithm_of, projection
from cg.jax.rotation_rules import rotation_logarithm, rotation_matrix
from cg.jax.rules import Rules, adjoint, held, linear, newton_schulz, real_dtype, same


def group_rules(frame: MatrixGroup) -> Rules:
    """Return the rules of a matrix group."""
    body = frame.convention == "body"
    inverse, restore = _inverse_and_restore(frame)
    exponential = exponential_of(frame)
    log1p = _log1p(frame, inverse)

    def flow(v: JaxArray, y: JaxArray) -> JaxArray:
        x = exponential(v)
        return y @ x if body else x @ y

    def quotient(y: JaxArray, change: JaxArray) -> JaxArray:
        return inverse(y) @ change if body else change @ inverse(y)

    def sizes(y: JaxArray) -> JaxArray:
        if not isinstance(frame, Semidirect):
            return jnp.ones(frame.dim, real_dtype(y))
        n = frame.group.size
        lengths = jnp.sqrt((y[:n, n:] ** 2).sum(axis=0))
        return jnp.concatenate([jnp.ones(frame.group.dim, y.dtype), jnp.repeat(lengths, n)])

    return Rules(
        frame,
        flow,
        restore,
        lambda y0, y1: log1p(quotient(y0, y1 - y0)),
        group_dexpinv(frame),
        lambda y, tangent: projection(frame, quotient(y, tangent)),
        sizes,
    )


def semidirect_rules(frame: Semidirect) -> Rules:
    """Return the rules of rigid motions; raise TypeError for groups other than SO(3)."""
    if not _is_rotation(frame.group):
        raise TypeError(
            f"frame must be a Semidirect of rotations of space in JAX, got {frame!r}; a FieldFrame "
            "takes a flow in jax.numpy"
        )
    return group_rules(frame)


def _is_rotation(frame: Frame) -> bool:
    return isinstance(frame, SO) and frame.n == 3


def _is_motion(frame: Frame) -> bool:
    return isinstance(frame, Semidirect) and _is_rotation(frame.group)


def exponential_of(frame: MatrixGroup) -> Callable[[JaxArray], JaxArray]:
    """Return the exponential as a function of coefficients."""
    if isinstance(frame, Semidirect):
        return lambda v: _motion(frame, v)
    if _is_rotation(frame):
        return lambda v: rotation_matrix(v, linear(v, frame.basis))
    if isinstance(frame, SO) and frame.n == 2:
        quarter = frame.basis[0]

        def turn(v: JaxArray) -> JaxArray:
            eye = jnp.eye(2, dtype=v.dtype)
            return jnp.cos(v[0]) * eye + jnp.sin(v[0]) * jnp.asarray(quarter, v.dtype)

        return turn
    if isinstance(frame, SU) and frame.n == 2:

        def spin(v: JaxArray) -> JaxArray:
            x2 = 0.25 * (v @ v)
            return stumpff(0, x2) * jnp.eye(2, dtype=v.dtype) + stumpff(1, x2) * linear(
                v, frame.basis
            )

        return spin
    return lambda v: expm(linear(v, frame.basis))


def _motion(frame: Semidirect, v: JaxArray) -> JaxArray:
    omega, wedge = v[:3], linear(v[:3], frame.group.basis)
    columns = v[3:].reshape(frame.copies, 3).T
    average = rotation_matrix(omega, wedge, average=1)
    return _assembled(rotation_matrix(omega, wedge), average @ columns)


def _assembled(linear: JaxArray, columns: JaxArray) -> JaxArray:
    n, k = columns.shape
    lower = jnp.eye(n + k, dtype=linear.dtype)[n:]
    return jnp.concatenate([jnp.concatenate([linear, columns], axis=1), lower])


def _inverse_and_restore(
    frame: MatrixGroup,
) -> tuple[Callable[[JaxArray], JaxArray], Callable[[JaxArray], JaxArray]]:
    if isinstance(frame, Semidirect):

        def inverse(y: JaxArray) -> JaxArray:
            turned = y[:3, :3].T
            return _assembled(turned, -turned @ y[:3, 3:])

        return inverse, lambda y: _assembled(newton_schulz(y[:3, :3]), y[:3, 3:])
    if isinstance(frame, SU):

        def restore(y: JaxArray) -> JaxArray:
            y = newton_schulz(y)
            return y * (1.0 - (jnp.linalg.det(y) - 1.0) / frame.n)

        return adjoint, restore
    if isinstance(frame, SO | U):
        return adjoint, newton_schulz
    if isinstance(frame, SL):
        return jnp.linalg.inv, held(_with_determinant_one)
    if isinstance(frame, Sp):
        return jnp.linalg.inv, held(lambda y: y + _symplectic_correction(frame, y))
    return jnp.linalg.inv, same


def _with_determinant_one(y: JaxArray) -> JaxArray:
    """Return a matrix after the Newton step of least norm, along the cofactors."""
    determinant, cofactors = jax.value_and_grad(jnp.linalg.det)(y)
    change = (1.0 - determinant) / (cofactors**2).sum() * cofactors
    return y + jnp.where(jnp.isfinite(change).all(), change, 0.0)


def _symplectic_correction(frame: Sp, y: JaxArray) -> JaxArray:
    """Return the change of `cg.frames.matrix_functions.symplectic_correction`."""
    form = jnp.asarray(frame._form, y.dtype)
    left, singular, right = jnp.linalg.svd(y)
    preserved = singular[:, None] * (left.T @ form @ left) * singular
    defect = preserved - right @ form @ right.T
    positive = jnp.maximum(singular, jnp.finfo(y.dtype).eps * singular[0])
    length = jnp.hypot(positive[:, None], positive)
    return form.T @ left @ (-singular[:, None] / length * (defect / length)) @ right


def _log1p(
    frame: MatrixGroup, inverse: Callable[[JaxArray], JaxArray]
) -> Callable[[JaxArray], JaxArray]:
    """Return the logarithm of the identity plus a matrix, as coefficients."""
    if _is_rotation(frame):
        return rotation_logarithm
    if isinstance(frame, Semidirect):
        return lambda away: _motion_logarithm(frame, away)
    if isinstance(frame, SO) and frame.n == 2:
        return lambda away: jnp.arctan2(away[1, 0] - away[0, 1], 2.0 + jnp.trace(away))[None]
    if isinstance(frame, SU) and frame.n == 2:

        def log1p(away: JaxArray) -> JaxArray:
            vector = 0.5 * projection(frame, away)
            scalar = 1.0 + 0.5 * jnp.trace(away).real
            return rotation_vector(vector, scalar)

        return log1p
    return logarithm_of(frame, inverse)


def _motion_logarithm(frame: Semidirect, away: JaxArray) -> JaxArray:
    omega = rotation_logarithm(away[:3, :3])
    wedge = linear(omega, frame.group.basis)
    columns = away[:3, 3:]
    once = wedge @ columns
    moved = columns - 0.5 * once + dexpinv_factor(omega @ omega) * (wedge @ once)
    return jnp.concatenate([omega, moved.T.reshape(-1)])


def group_dexpinv(frame: MatrixGroup) -> Callable[[JaxArray, JaxArray, int], JaxArray]:
    """Return dexpinv by a closed form where there is one, else by its series."""
    if _is_rotation(frame) or (isinstance(frame, SU) and frame.n == 2):
        return turning_dexpinv(frame._side)
    if _is_motion(frame):
        return lambda u, v, order: motion_dexpinv(u, v, frame._side)
    return series_dexpinv(frame)
