r"""Rules of matrix groups and unit quaternions, and rotations as vectors and quaternions.

The flow of v on a matrix group is y exp(v) in the body convention and exp(v) y in the space
convention. The coefficients that take y to y1 are those of log(1 + x), where x = y⁻¹ (y1 - y), or
(y1 - y) y⁻¹, keeps its digits for near points. `functions_of` makes the exponential, the logarithm
and dexpinv of each kind of group: closed forms for rotations of the plane and of space, SU(2) and
rigid motions, else those of `cg.jax.matrices` and the series of dexpinv.

With the bracket :math:`\operatorname{ad}_u v` and Bernoulli's numbers dexpinv, the inverse of the
derivative of the exponential, is :math:`\sum_k B_k / k! \operatorname{ad}_u^k v`, see
`cg.frames.algebra`. Where brackets are plus or minus the cross product with :math:`q = |u|^2` it is

.. math:: v \mp \tfrac12 u \times v + g(q)\, u \times (u \times v),

with `dexpinv_factor` g, and on rigid motions :math:`v - \tfrac12 \operatorname{ad}_u v + a(q)
\operatorname{ad}_u^2 v + b(q) \operatorname{ad}_u^4 v` with `motion_factors` a and b. As in
NumPy the value is NaN where the infinite series diverges, though only a few of its terms are
summed, and v where u and v commute.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cg.frames import SL, SO, SU, Frame, MatrixGroup, Semidirect, Sp, U, UnitQuaternion
from cg.frames.algebra import POWERS, RADIUS, series_terms
from cg.frames.matrix_functions import newton_schulz, symplectic_correction
from cg.jax.entire_functions import dexpinv_factor, motion_factors, rotation_vector, stumpff
from cg.jax.matrices import expm, logarithm_of, projection
from cg.jax.rules import (
    Dexpinv,
    JaxArray,
    Map,
    Rules,
    act,
    adjoint,
    bilinear,
    column_error,
    cross,
    dot,
    length_error,
    linear,
    same,
    unit_step,
    with_identity_derivative,
    zero,
)
from cg.support.shared_numbers import COMMUTING_ROUNDINGS

_SQUARED_RADIUS = RADIUS**2


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
                products = cross(omega, w[k : k + 3]), cross(x[k : k + 3], w[:3])
                value += [a + b for a, b in zip(*products, strict=True)]
            return value

        q = dot(omega, omega)
        # Zero beyond the radius, so that values that aren't used have finite derivatives
        within = jnp.where(q < _SQUARED_RADIUS, q, 0.0)
        once = bracket(y)
        twice = bracket(once)
        factors, brackets = [-0.5 * side], [once, twice]
        if len(x) == 3:
            factors.append(dexpinv_factor(within))
        else:
            factors.extend(motion_factors(within))
            brackets.append(bracket(bracket(twice)))
        value = jnp.stack([a + dot(factors, row) for a, *row in zip(y, *brackets, strict=True)])
        bound = (COMMUTING_ROUNDINGS * jnp.finfo(q.dtype).eps) ** 2 * q
        commutes = bound * dot(y, y) >= dot(once, once)
        # v stays as it is, with the derivatives of the value: rounding grows near the radius
        exact = value + jax.lax.stop_gradient(v - value)
        value = jnp.where(commutes & (q >= _SQUARED_RADIUS / 4.0), exact, value)
        return jnp.where(q < _SQUARED_RADIUS, value, jnp.where(commutes, v, jnp.nan))

    return dexpinv


def make_series_dexpinv(frame: Frame) -> Dexpinv:
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
    rounding = COMMUTING_ROUNDINGS * jnp.finfo(bound.dtype).eps * bound

    def growth() -> tuple[JaxArray, JaxArray]:
        def multiply(power: JaxArray, _: Any) -> tuple[JaxArray, JaxArray]:
            power = power @ matrix
            factor = jnp.sqrt(power @ power)
            significant = factor > rounding
            power = jnp.where(significant, power / jnp.where(significant, factor, 1.0), 0.0)
            return power, jnp.where(significant, factor, 0.0)

        size = jnp.sqrt(fixed @ fixed)
        unit = fixed / jnp.where(size > 0.0, size, 1.0)
        factors = jax.lax.scan(multiply, unit, None, length=POWERS)[1]
        later = factors[POWERS // 2 :]
        return jnp.prod(later) ** (1.0 / len(later)), factors[0] == 0.0

    slow = jnp.zeros_like(bound), jnp.zeros((), bool)
    rate, commuting = jax.lax.cond(bound * bound >= _SQUARED_RADIUS, growth, lambda: slow)
    # An infinite bound says nothing about eigenvalues.
    converges = jnp.isfinite(bound) & (rate * rate < _SQUARED_RADIUS)
    # v stays as it is, with the derivatives of the sum unless rounding has grown in that
    change = fixed - jax.lax.stop_gradient(total)
    exact = jnp.where((jnp.abs(change) <= 1e-6 * jnp.abs(fixed).max()).all(), total + change, v)
    return jnp.where(commuting & jnp.isfinite(bound), exact, jnp.where(converges, total, jnp.nan))


@dataclass(frozen=True, eq=False)
class Group:
    """The functions of a group, of coefficients v or matrices; ``log1p(x)`` is the log of 1 + x."""

    exponential: Map
    log1p: Map
    dexpinv: Dexpinv
    inverse: Map
    restore: Map = same
    relative_error: Map = zero
    unequal_sizes: Map | None = None


def group_rules(frame: MatrixGroup) -> Rules:
    """Return the rules of a matrix group."""
    body, group = frame.convention == "body", functions_of(frame)

    def act(x: JaxArray, y: JaxArray) -> JaxArray:
        return y @ x if body else x @ y

    def quotient(y: JaxArray, change: JaxArray) -> JaxArray:
        return group.inverse(y) @ change if body else change @ group.inverse(y)

    return Rules(
        frame, lambda v, y: act(group.exponential(v), y), group.restore,
        lambda y0, y1: group.log1p(quotient(y0, y1 - y0)), group.dexpinv,
        lambda y, tangent: projection(frame, quotient(y, tangent)), group.unequal_sizes,
        group.relative_error, closed_field=lambda v, y: act(linear(v, frame.basis), y),
    )  # fmt: skip


def semidirect_rules(frame: Semidirect) -> Rules:
    """Return the rules of rigid motions; raise TypeError for groups other than SO(3)."""
    if not _is_rotation(frame.group):
        raise TypeError(
            f"frame must be a Semidirect of rotations of space in JAX, got {frame!r}; a FieldFrame "
            "takes a flow in jax.numpy"
        )
    n, rotations = frame.group.size, group_rules(frame.group)

    def coefficients(y: JaxArray, tangent: JaxArray) -> JaxArray:
        v, columns = rotations.coefficients(y[:n, :n], tangent[:n, :n]), tangent[:n, n:]
        if frame.convention == "body":
            columns = y[:n, :n].T @ columns
        else:
            columns = columns - linear(v, frame.group.basis) @ y[:n, n:]
        return jnp.concatenate([v, columns.T.reshape(-1)])

    return replace(group_rules(frame), closed_coefficients=coefficients)


def quaternion_rules(frame: UnitQuaternion) -> Rules:
    """Return the rules of unit quaternions."""
    generators = frame.field(np.eye(3)[:, None], np.eye(4)).mT

    def flow(v: JaxArray, y: JaxArray) -> JaxArray:
        # `act` rounds alike in steps that an adjoint repeats, unlike the scalars of `sines`.
        x2 = 0.25 * (v @ v)
        return stumpff(0, x2) * y + stumpff(1, x2) * act(v, generators, y)

    def sines(y: JaxArray, end: JaxArray) -> JaxArray:
        return jnp.stack(bilinear(2.0 * generators, list(end), list(y)))

    def log(y0: JaxArray, y1: JaxArray) -> JaxArray:
        return rotation_vector(sines(y0, y1 - y0), y0 @ y1)

    def coefficients(y: JaxArray, tangent: JaxArray) -> JaxArray:
        return 2.0 * sines(y, tangent)

    dexpinv = motion_dexpinv(frame._rotation_sign)
    return Rules(
        frame, flow, unit_step, log, dexpinv, coefficients, relative_error=length_error,
        closed_field=lambda v, y: act(v, generators, y),
    )  # fmt: skip


def functions_of(frame: MatrixGroup) -> Group:
    """Return the functions of a group, in closed form where there is one."""
    if isinstance(frame, Semidirect):
        return _motions(frame)
    group = _general(frame)
    basis = frame.basis
    if _is_rotation(frame):
        return replace(
            group,
            exponential=lambda v: rotation_matrix(v, linear(v, basis)),
            log1p=rotation_logarithm,
            dexpinv=motion_dexpinv(frame._side),
        )
    if isinstance(frame, SO) and frame.n == 2:

        def turn(v: JaxArray) -> JaxArray:
            eye = jnp.eye(2, dtype=v.dtype)
            return jnp.cos(v[0]) * eye + jnp.sin(v[0]) * jnp.asarray(basis[0], v.dtype)

        def angle(x: JaxArray) -> JaxArray:
            return jnp.arctan2(x[1, 0] - x[0, 1], 2.0 + jnp.trace(x))[None]

        return replace(group, exponential=turn, log1p=angle)
    if isinstance(frame, SU) and frame.n == 2:

        def spin(v: JaxArray) -> JaxArray:
            x2 = 0.25 * (v @ v)
            even, odd = stumpff(0, x2), stumpff(1, x2)
            return even * jnp.eye(2, dtype=v.dtype) + odd * linear(v, basis)

        def vector(x: JaxArray) -> JaxArray:
            return rotation_vector(0.5 * projection(frame, x), 1.0 + 0.5 * jnp.trace(x).real)

        dexpinv = motion_dexpinv(frame._side)
        return replace(group, exponential=spin, log1p=vector, dexpinv=dexpinv)
    return group


def _is_rotation(frame: Frame) -> bool:
    return isinstance(frame, SO) and frame.n == 3


def _general(frame: MatrixGroup) -> Group:
    """Return the functions of a group by exponentials and logarithms of matrices."""
    inverse = adjoint if isinstance(frame, SO | SU | U) else jnp.linalg.inv
    exponential, log1p = (lambda v: expm(linear(v, frame.basis))), logarithm_of(frame, inverse)
    restore: Map = same
    relative_error: Map = zero
    if isinstance(frame, SO | SU):

        def restore(y: JaxArray) -> JaxArray:
            y = newton_schulz(y)
            if isinstance(frame, SO):
                return y
            return y * (1.0 - (jnp.linalg.det(y) - 1.0) / frame.n)

        def relative_error(y: JaxArray) -> JaxArray:
            return jnp.maximum(column_error(y), jnp.abs(jnp.linalg.det(y) - 1.0))

    elif isinstance(frame, U):
        restore, relative_error = newton_schulz, column_error
    elif isinstance(frame, SL | Sp):
        restore = with_identity_derivative(
            _with_determinant_one
            if isinstance(frame, SL)
            else lambda y: y + symplectic_correction(y, jnp.asarray(frame._form, y.dtype), jnp)
        )

        def relative_error(y: JaxArray) -> JaxArray:
            return jnp.linalg.norm(restore(y) - y, 2) / jnp.linalg.norm(y, 2)

    return Group(exponential, log1p, make_series_dexpinv(frame), inverse, restore, relative_error)


def _with_determinant_one(y: JaxArray) -> JaxArray:
    """Return a matrix after the Newton step of least norm, along the cofactors."""
    determinant, cofactors = jax.value_and_grad(jnp.linalg.det)(y)
    change = (1.0 - determinant) / (cofactors**2).sum() * cofactors
    return y + jnp.where(jnp.isfinite(change).all(), change, 0.0)


def _motions(frame: Semidirect) -> Group:
    """Return the functions of rotations of space with vectors that rotate, as columns."""
    rotations, n = functions_of(frame.group), frame.group.size

    def exponential(v: JaxArray) -> JaxArray:
        omega, wedge = v[:3], linear(v[:3], frame.group.basis)
        columns = v[3:].reshape(frame.copies, 3).T
        return _assembled(rotation_matrix(omega, wedge), average_rotation(omega, wedge) @ columns)

    def log1p(x: JaxArray) -> JaxArray:
        omega = rotation_logarithm(x[:3, :3])
        wedge = linear(omega, frame.group.basis)
        columns = x[:3, 3:]
        once = wedge @ columns
        columns = columns - 0.5 * once + dexpinv_factor(omega @ omega) * (wedge @ once)
        return jnp.concatenate([omega, columns.T.reshape(-1)])

    def inverse(y: JaxArray) -> JaxArray:
        transposed = y[:3, :3].T
        return _assembled(transposed, -transposed @ y[:3, 3:])

    def sizes(y: JaxArray) -> JaxArray:
        lengths = jnp.sqrt((y[:n, n:] ** 2).sum(axis=0))
        return jnp.concatenate([jnp.ones(frame.group.dim, y.dtype), jnp.repeat(lengths, n)])

    def relative_error(y: JaxArray) -> JaxArray:
        lower = jnp.abs(y[n:] - jnp.eye(len(y))[n:]).max()
        return jnp.maximum(rotations.relative_error(y[:n, :n]), lower)

    return Group(
        exponential, log1p, motion_dexpinv(frame._side), inverse,
        lambda y: _assembled(newton_schulz(y[:3, :3]), y[:3, 3:]), relative_error, sizes,
    )  # fmt: skip


def _assembled(rotation: JaxArray, columns: JaxArray) -> JaxArray:
    n, k = columns.shape
    lower = jnp.eye(n + k, dtype=rotation.dtype)[n:]
    return jnp.concatenate([jnp.concatenate([rotation, columns], axis=1), lower])


def rotation_matrix(v: JaxArray, wedge: JaxArray) -> JaxArray:
    """Return the rotation by v, whose skew matrix is `wedge`.

    Half angles need no function but sine and cosine, which compiles faster.
    """
    q = 0.25 * (v @ v)
    cosine, sinc = stumpff(0, q), stumpff(1, q)
    unit = cosine * cosine - q * (sinc * sinc)
    once, twice = cosine * sinc, 0.5 * (sinc * sinc)
    return unit * jnp.eye(3, dtype=v.dtype) + (once * wedge + twice * jnp.outer(v, v))


def average_rotation(v: JaxArray, wedge: JaxArray) -> JaxArray:
    """Return the integral of the rotation by s v over s from 0 to 1."""
    q = v @ v
    unit, once, twice = (stumpff(k, q) for k in (1, 2, 3))
    return unit * jnp.eye(3, dtype=v.dtype) + (once * wedge + twice * jnp.outer(v, v))


def rotation_logarithm(difference: JaxArray) -> JaxArray:
    """Return the rotation vector of the identity plus a matrix, as `cg.frames.rotations` has it."""
    # The largest row of the quaternion's square of rank one, scalar last
    trace = jnp.trace(difference)
    skew = difference - difference.T
    axial = jnp.stack([skew[2, 1], skew[0, 2], skew[1, 0]])
    block = difference + difference.T + jnp.diag(-trace * jnp.ones(3, difference.dtype))
    outer = jnp.block([[block, axial[:, None]], [axial[None, :], (4.0 + trace)[None, None]]])
    q = outer[jnp.argmax(jnp.diagonal(outer))]
    q = q / jnp.sqrt(q @ q)
    q = jnp.where(q[3] < 0.0, -q, q)
    return rotation_vector(q[:3], q[3])
