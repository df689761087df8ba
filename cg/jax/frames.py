"""What each frame is in JAX: functions of one point, which `jax.vmap` makes ones of many.

Coefficients have shape ``(dim,)``, points ``point_shape``, and results the type of the point that
they are made of: float32 or float64, complex64 or complex128.  All are smooth wherever the
mathematics is, at coefficients zero and at equal points too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from cg.frames import (
    GL,
    SE3,
    SO,
    SO3,
    SU,
    Euclidean,
    FieldFrame,
    Frame,
    MatrixFrame,
    MatrixGroup,
    Power,
    Product,
    Semidirect,
    Sphere,
    Stiefel,
    U,
    UnitQuaternion,
)
from cg.frames.dexpinv import bernoulli_terms
from cg.frames.quaternion import _generators
from cg.integration.step.plan import has_brackets
from cg.jax.entire import JaxArray, angle_over_sine, dexpinv_factor, motion_factors, stumpff

__all__ = ["Rules", "rules_of"]

_ROOTS = 3  # square roots before a logarithm's series
_ROOT_STEPS = 8
_ARTANH_TERMS = 12
_NEAR_IDENTITY = 0.25
_NEARBY_STEPS = 4
_RADIUS = (2.0 * np.pi) ** 2  # of the series of dexpinv, squared
_COMMUTE = 16.0


@dataclass(frozen=True, eq=False)
class Rules:
    """A frame as functions of JAX.

    Attributes
    ----------
    frame
        The frame.
    flow, restore
        ``flow(v, y)`` leaves rounding errors, which ``restore(y)`` removes.
    log
        ``log(y0, y1)``, the coefficients whose flow takes one point to the other; None where the
        frame has no `cg.frames.Frame.exp_coordinates`.
    dexpinv
        ``dexpinv(u, v, order)`` as `cg.frames.Frame.dexpinv`; None without brackets.
    coefficients
        ``coefficients(y, tangent)``, the shortest ones whose field is nearest to a tangent.
    sizes
        ``sizes(y)`` as `cg.frames.Frame.coordinate_sizes`, shape ``(dim,)``.
    free
        Whether small coefficients are known from the two points that they lead between.
    """

    frame: Frame
    flow: Callable[[JaxArray, JaxArray], JaxArray]
    restore: Callable[[JaxArray], JaxArray]
    log: Callable[[JaxArray, JaxArray], JaxArray] | None
    dexpinv: Callable[[JaxArray, JaxArray, int], JaxArray] | None
    coefficients: Callable[[JaxArray, JaxArray], JaxArray]
    sizes: Callable[[JaxArray], JaxArray]
    free: bool = True

    def field(self, v: JaxArray, y: JaxArray) -> JaxArray:
        """Return the tangent at ``y``: the derivative of the flow."""
        return jax.jvp(lambda w: self.flow(w, y), (jnp.zeros_like(v),), (v,))[1]

    def nearby(self, y0: JaxArray, y1: JaxArray) -> JaxArray:
        """Return coefficients whose flow takes ``y0`` to a point near it, for any frame."""
        if self.log is not None:
            return self.log(y0, y1)
        v = jnp.zeros(self.frame.dim, real_dtype(y0))
        for _ in range(_NEARBY_STEPS):
            y = self.flow(v, y0)
            v = v + self.coefficients(y, y1 - y)
        return v

    def measured(self, v: JaxArray, y: JaxArray) -> JaxArray:
        """Return what errors are measured in: shortest coefficients, or entries of the tangent."""
        if self.log is not None and self.free:
            return v
        tangent = self.field(v, y)
        return tangent if self.log is None else self.coefficients(y, tangent)

    def measured_sizes(self, y: JaxArray) -> JaxArray:
        """Return the sizes that `measured` numbers are relative to, which have their shape."""
        if self.log is not None:
            return self.sizes(y)
        return jnp.full(y.shape, jnp.sqrt((jnp.abs(y) ** 2).mean()))

    def extent(self, x: JaxArray, y: JaxArray) -> JaxArray:
        """Return 1 and the larger of the sizes at two points, added."""
        return 1.0 + jnp.maximum(self.measured_sizes(x), self.measured_sizes(y))


def real_dtype(y: JaxArray) -> Any:
    """Return the type of the real part of an array."""
    return jnp.finfo(jnp.result_type(y)).dtype


def rules_of(frame: Frame) -> Rules:
    """Return what a frame is in JAX.

    Raises
    ------
    TypeError
        If it is no frame, or none that JAX has functions for.
    """
    if not isinstance(frame, Frame):
        raise TypeError(f"frame must be a cg.frames.Frame, got {frame!r}")
    try:
        return _rules(frame)
    except TypeError as error:
        if "unhashable" not in str(error):
            raise
        return _rules.__wrapped__(frame)


@lru_cache(maxsize=256)
def _rules(frame: Frame) -> Rules:
    make = _MAKERS.get(type(frame))
    if make is None:
        known = ", ".join(kind.__name__ for kind in _MAKERS)
        raise TypeError(
            f"frame must be one of {known} in JAX, got {frame!r}; a FieldFrame takes a flow in "
            "jax.numpy"
        )
    return make(frame)


def _ones(frame: Frame) -> Callable[[JaxArray], JaxArray]:
    return lambda y: jnp.ones(frame.dim, real_dtype(y))


def _same(y: JaxArray) -> JaxArray:
    return y


def _linear(v: JaxArray, basis: NDArray[Any]) -> JaxArray:
    """Return the combination of matrices with real coefficients, in their precision."""
    dtype = v.dtype if basis.dtype.kind == "f" else jnp.result_type(v.dtype, np.complex64)
    flat = jnp.asarray(basis.reshape(len(basis), -1), dtype)
    return (v.astype(dtype) @ flat).reshape(basis.shape[1:])


def _unit_step(y: JaxArray) -> JaxArray:
    return (1.5 - 0.5 * (y @ y)) * y


def _adjoint(y: JaxArray) -> JaxArray:
    return y.T.conj()


def _newton_schulz(y: JaxArray) -> JaxArray:
    return 1.5 * y - 0.5 * (y @ (_adjoint(y) @ y))


# Rotations


def _rotation_rules(frame: UnitQuaternion) -> Rules:
    generators = _generators(frame.convention, frame.scalar_first)

    def flow(v: JaxArray, y: JaxArray) -> JaxArray:
        x2 = 0.25 * (v @ v)
        return stumpff(0, x2) * y + stumpff(1, x2) * (_linear(v, generators) @ y)

    def sines(y: JaxArray, end: JaxArray) -> JaxArray:
        return (jnp.asarray(2.0 * generators, y.dtype) @ y) @ end

    def log(y0: JaxArray, y1: JaxArray) -> JaxArray:
        vector = sines(y0, y1 - y0)
        return 2.0 * angle_over_sine(vector @ vector, y0 @ y1) * vector

    return Rules(
        frame,
        flow,
        _unit_step,
        log,
        _turning(frame._rotation_sign),
        lambda y, tangent: 2.0 * sines(y, tangent),
        _ones(frame),
    )


def _turning(side: float) -> Callable[[JaxArray, JaxArray, int], JaxArray]:
    """Return dexpinv where brackets are plus or minus the cross product."""

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        q = u @ u
        once = jnp.cross(u, v)
        value = v - (0.5 * side) * once + dexpinv_factor(_within(q)) * jnp.cross(u, once)
        return _beyond_a_turn(value, q, v, once)

    return dexpinv


def _within(q: JaxArray) -> JaxArray:
    return jnp.where(q < _RADIUS, q, 0.0)


def _beyond_a_turn(value: JaxArray, q: JaxArray, v: JaxArray, once: JaxArray) -> JaxArray:
    """Return `value`, and after a turn or more ``v`` where it commutes, else NaN."""
    bound = (_COMMUTE * jnp.finfo(q.dtype).eps) ** 2 * q * (v @ v)
    after = jnp.where(once @ once <= bound, v, jnp.nan)
    return jnp.where(q < _RADIUS, value, after)


def _rotation_matrix(v: JaxArray, wedge: JaxArray) -> JaxArray:
    """Return the rotation by v, whose skew matrix is `wedge`."""
    q = v @ v
    return stumpff(0, q) * jnp.eye(3, dtype=v.dtype) + (
        stumpff(1, q) * wedge + stumpff(2, q) * jnp.outer(v, v)
    )


def _average(v: JaxArray, wedge: JaxArray) -> JaxArray:
    """Return the integral of the rotation by s v over s from 0 to 1."""
    q = v @ v
    return stumpff(1, q) * jnp.eye(3, dtype=v.dtype) + (
        stumpff(2, q) * wedge + stumpff(3, q) * jnp.outer(v, v)
    )


def _rotation_logarithm(away: JaxArray) -> JaxArray:
    """Return the rotation vector of the identity plus `away`, as `cg.frames.rotations` has it."""
    trace = jnp.trace(away)
    axial = jnp.stack([away[2, 1] - away[1, 2], away[0, 2] - away[2, 0], away[1, 0] - away[0, 1]])
    block = away + away.T + jnp.diag(-trace * jnp.ones(3, away.dtype))
    outer = jnp.block([[block, axial[:, None]], [axial[None, :], (4.0 + trace)[None, None]]])
    q = outer[jnp.argmax(jnp.diagonal(outer))]
    q = q / jnp.sqrt(q @ q)
    q = jnp.where(q[3] < 0.0, -q, q)
    return 2.0 * angle_over_sine(q[:3] @ q[:3], q[3]) * q[:3]


# Matrix groups


def _group_rules(frame: MatrixGroup) -> Rules:
    body = frame.convention == "body"
    inverse, restore = _inverse_and_restore(frame)
    exponential = _exponential(frame)
    log1p = _log1p(frame)

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
        _group_dexpinv(frame),
        lambda y, tangent: _projection(frame, quotient(y, tangent)),
        sizes,
    )


def _is_rotation(frame: Frame) -> bool:
    return isinstance(frame, SO) and frame.n == 3


def _is_motion(frame: Frame) -> bool:
    return isinstance(frame, Semidirect) and _is_rotation(frame.group)


def _projection(frame: MatrixGroup, matrix: JaxArray) -> JaxArray:
    """Return the coefficients of the orthogonal projection of a matrix onto the algebra."""
    dual = frame._dual.conj().T
    dtype = matrix.dtype if dual.dtype.kind == "f" else jnp.result_type(matrix, np.complex64)
    return (matrix.reshape(-1) @ jnp.asarray(dual, dtype)).real


def _exponential(frame: MatrixGroup) -> Callable[[JaxArray], JaxArray]:
    if isinstance(frame, Semidirect):
        return lambda v: _motion(frame, v)
    if _is_rotation(frame):
        return lambda v: _rotation_matrix(v, _linear(v, frame.basis))
    if isinstance(frame, SO) and frame.n == 2:
        quarter = frame.basis[0]

        def turn(v: JaxArray) -> JaxArray:
            eye = jnp.eye(2, dtype=v.dtype)
            return jnp.cos(v[0]) * eye + jnp.sin(v[0]) * jnp.asarray(quarter, v.dtype)

        return turn
    if isinstance(frame, SU) and frame.n == 2:

        def spin(v: JaxArray) -> JaxArray:
            x2 = 0.25 * (v @ v)
            return stumpff(0, x2) * jnp.eye(2, dtype=v.dtype) + stumpff(1, x2) * _linear(
                v, frame.basis
            )

        return spin
    return lambda v: jax.scipy.linalg.expm(_linear(v, frame.basis), max_squarings=24)


def _motion(frame: Semidirect, v: JaxArray) -> JaxArray:
    omega, wedge = v[:3], _linear(v[:3], frame.group.basis)
    columns = v[3:].reshape(frame.copies, 3).T
    return _assembled(_rotation_matrix(omega, wedge), _average(omega, wedge) @ columns)


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

        return inverse, lambda y: _assembled(_newton_schulz(y[:3, :3]), y[:3, 3:])
    if isinstance(frame, SU):

        def restore(y: JaxArray) -> JaxArray:
            y = _newton_schulz(y)
            return y * (1.0 - (jnp.linalg.det(y) - 1.0) / frame.n)

        return _adjoint, restore
    if isinstance(frame, SO | U):
        return _adjoint, _newton_schulz
    return jnp.linalg.inv, _same


def _log1p(frame: MatrixGroup) -> Callable[[JaxArray], JaxArray]:
    """Return the logarithm of the identity plus a matrix, as coefficients."""
    if _is_rotation(frame):
        return _rotation_logarithm
    if isinstance(frame, Semidirect):
        return lambda away: _motion_logarithm(frame, away)
    if isinstance(frame, SO) and frame.n == 2:
        return lambda away: jnp.arctan2(away[1, 0] - away[0, 1], 2.0 + jnp.trace(away))[None]
    if isinstance(frame, SU) and frame.n == 2:

        def log1p(away: JaxArray) -> JaxArray:
            vector = 0.5 * _projection(frame, away)
            scalar = 1.0 + 0.5 * jnp.trace(away).real
            return 2.0 * angle_over_sine(vector @ vector, scalar) * vector

        return log1p
    return lambda away: _projection(frame, _matrix_log1p(away))


def _motion_logarithm(frame: Semidirect, away: JaxArray) -> JaxArray:
    omega = _rotation_logarithm(away[:3, :3])
    wedge = _linear(omega, frame.group.basis)
    columns = away[:3, 3:]
    once = wedge @ columns
    moved = columns - 0.5 * once + dexpinv_factor(omega @ omega) * (wedge @ once)
    return jnp.concatenate([omega, moved.T.reshape(-1)])


def _matrix_log1p(away: JaxArray) -> JaxArray:
    """Return the principal logarithm of the identity plus a matrix.

    Near the identity it is a series in the matrix itself, which keeps its digits; farther away
    square roots come first, by the iteration of Denman and Beavers.
    """
    eye = jnp.eye(len(away), dtype=away.dtype)
    near = (jnp.abs(away) ** 2).sum() < _NEAR_IDENTITY**2

    def series(small: JaxArray) -> JaxArray:
        z = jnp.linalg.solve(small + 2.0 * eye, small)
        square = z @ z
        total = eye / (2 * _ARTANH_TERMS + 1)
        for j in range(_ARTANH_TERMS - 1, -1, -1):
            total = eye / (2 * j + 1) + square @ total
        return 2.0 * (z @ total)

    def root(x: JaxArray, _: Any) -> tuple[JaxArray, None]:
        def step(pair: Any, _: Any) -> Any:
            y, z = pair
            return (0.5 * (y + jnp.linalg.inv(z)), 0.5 * (z + jnp.linalg.inv(y))), None

        return jax.lax.scan(step, (x, eye), None, length=_ROOT_STEPS)[0][0], None

    whole = jnp.where(near, eye, eye + away)
    far, _ = jax.lax.scan(root, whole, None, length=_ROOTS)
    reduced = jnp.where(near, away, far - eye)
    return jnp.where(near, 1.0, 2.0**_ROOTS) * series(reduced)


def _group_dexpinv(frame: MatrixGroup) -> Callable[[JaxArray, JaxArray, int], JaxArray]:
    if _is_rotation(frame) or (isinstance(frame, SU) and frame.n == 2):
        return _turning(frame._side)
    if _is_motion(frame):
        return lambda u, v, order: _motion_dexpinv(u, v, frame._side)
    return _series(frame)


def _motion_dexpinv(u: JaxArray, v: JaxArray, side: float) -> JaxArray:
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


def _series(frame: Frame) -> Callable[[JaxArray, JaxArray, int], JaxArray]:
    """Return dexpinv by its series as far as a method of an order needs it."""
    constants = frame._adjoint_basis

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        terms = [float(term) for term in bernoulli_terms(max(order - 2, 0))[1:]]
        while terms and not terms[-1]:
            terms.pop()
        if not terms:
            return v
        matrix = _linear(u, constants)
        total = power = v
        for term in terms:
            power = power @ matrix
            if term:
                total = total + term * power
        return total

    return dexpinv


# Other manifolds


def _euclidean_rules(frame: Euclidean) -> Rules:
    return Rules(
        frame,
        lambda v, y: y + v,
        _same,
        lambda y0, y1: y1 - y0,
        lambda u, v, order: v,
        lambda y, tangent: tangent,
        jnp.abs,
    )


def _sphere_rules(frame: Sphere) -> Rules:
    group = frame.group
    exponential = _exponential(group)

    def turn(start: JaxArray, end: JaxArray) -> JaxArray:
        wedge = jnp.outer(end, start)
        return _projection(group, wedge - wedge.T)

    def log(y0: JaxArray, y1: JaxArray) -> JaxArray:
        cosine = y0 @ y1
        vector = turn(y0, y1 - jnp.where(cosine < 0.0, -1.0, 1.0) * y0)
        return angle_over_sine(vector @ vector, cosine) * vector

    return Rules(
        frame,
        lambda v, y: exponential(v) @ y,
        _unit_step,
        log,
        _group_dexpinv(group),
        turn,
        _ones(frame),
        free=False,
    )


def _stiefel_rules(frame: Stiefel) -> Rules:
    group = frame.group
    exponential = _exponential(group)

    def coefficients(y: JaxArray, tangent: JaxArray) -> JaxArray:
        mixed = y.T @ tangent
        along = 0.5 * (mixed - mixed.T)
        left = (tangent - y @ mixed + 0.5 * (y @ along)) @ y.T
        return _projection(group, left - left.T)

    return Rules(
        frame,
        lambda v, y: exponential(v) @ y,
        _newton_schulz,
        None,
        _group_dexpinv(group),
        coefficients,
        _ones(frame),
        free=False,
    )


def _own_rules(frame: FieldFrame | MatrixFrame) -> Rules:
    """Return the rules of a frame whose functions the user has written in jax.numpy."""
    functions = frame._functions
    if isinstance(frame, FieldFrame):
        flow = frame._flow
    else:

        def flow(v: JaxArray, y: JaxArray) -> JaxArray:
            return jax.scipy.linalg.expm(_linear(v, frame.matrices), max_squarings=24) @ y

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
        functions.get("restore", _same),
        functions.get("exp_coordinates"),
        _series(frame) if has_brackets(frame) else None,
        coefficients,
        _ones(frame),
        free=False,
    )
    return rules


def _product_rules(frame: Product) -> Rules:
    parts = [rules_of(factor) for factor in frame.factors]
    vectors = frame._vector_slices

    def joined(*points: JaxArray) -> JaxArray:
        return join(frame, *points)

    def cut(v: JaxArray) -> list[JaxArray]:
        return [v[place] for place in vectors]

    def each(name: str, *arguments: Any) -> list[JaxArray]:
        return [getattr(rules, name)(*rest) for rules, *rest in zip(parts, *arguments, strict=True)]

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        orders = [order] * len(parts)
        return jnp.concatenate(each("dexpinv", cut(u), cut(v), orders))

    def together(name: str) -> Callable[[JaxArray, JaxArray], JaxArray]:
        return lambda x, y: jnp.concatenate(each(name, split(frame, x), split(frame, y)))

    return Rules(
        frame,
        lambda v, y: joined(*each("flow", cut(v), split(frame, y))),
        lambda y: joined(*each("restore", split(frame, y))),
        None if any(rules.log is None for rules in parts) else together("log"),
        None if any(rules.dexpinv is None for rules in parts) else dexpinv,
        together("coefficients"),
        lambda y: jnp.concatenate(each("sizes", split(frame, y))),
        free=all(rules.free for rules in parts),
    )


def split(frame: Product, y: JaxArray) -> tuple[JaxArray, ...]:
    """Return the points of the factors of a product.

    Parameters
    ----------
    frame
        A `cg.frames.Product`.
    y
        Shape ``frame.point_shape``.

    Returns
    -------
    tuple of arrays
        One of the shape ``point_shape`` of each factor.

    Raises
    ------
    TypeError
        If ``frame`` is no product.
    ValueError
        If ``y`` has another shape.

    Examples
    --------
    >>> import cg
    >>> frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
    >>> [part.shape for part in cg.jax.split(frame, np.arange(7.0))]
    [(4,), (3,)]
    """
    _check_product(frame)
    y = jnp.asarray(y)
    if y.shape != frame.point_shape:
        raise ValueError(f"y must have shape {frame.point_shape}, got {y.shape}")
    parts = []
    for factor, place in zip(frame.factors, frame._point_slices, strict=True):
        part = y[place]
        if factor.dtype.kind == "c":
            part = part.reshape(-1, 2)
            part = jax.lax.complex(part[:, 0], part[:, 1])
        parts.append(part.reshape(factor.point_shape))
    return tuple(parts)


def join(frame: Product, *parts: JaxArray) -> JaxArray:
    """Return the point of a product that `split` takes apart.

    Parameters
    ----------
    frame
        A `cg.frames.Product`.
    *parts
        A point of each factor, shape ``factor.point_shape``.

    Returns
    -------
    array
        Shape ``frame.point_shape``.

    Raises
    ------
    TypeError
        If ``frame`` is no product.
    ValueError
        If the number of parts or a shape is wrong.

    Examples
    --------
    >>> import cg
    >>> frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
    >>> join(frame, np.ones(4), np.zeros(3)).tolist()
    [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    """
    _check_product(frame)
    if len(parts) != len(frame.factors):
        raise ValueError(f"parts must be {len(frame.factors)} points, got {len(parts)}")
    flat = []
    for index, (factor, part) in enumerate(zip(frame.factors, parts, strict=True)):
        point = jnp.asarray(part)
        if point.shape != factor.point_shape:
            raise ValueError(
                f"parts[{index}] must have shape {factor.point_shape}, got {point.shape}"
            )
        if factor.dtype.kind == "c":
            point = jnp.stack([point.real, point.imag], axis=-1)
        flat.append(point.reshape(-1))
    return jnp.concatenate(flat)


def _check_product(frame: Any) -> None:
    if not isinstance(frame, Product):
        raise TypeError(f"frame must be a cg.frames.Product, got {frame!r}")


def _power_rules(frame: Power) -> Rules:
    rules = rules_of(frame.factor)
    n, m = frame.n, frame.factor.dim

    def on_points(function: Callable[..., JaxArray]) -> Callable[..., JaxArray]:
        return lambda *points: jax.vmap(function)(*points).reshape(-1)

    def flow(v: JaxArray, y: JaxArray) -> JaxArray:
        return jax.vmap(rules.flow)(v.reshape(n, m), y)

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        inverse = rules.dexpinv
        assert inverse is not None
        each = jax.vmap(lambda x, y: inverse(x, y, order))
        return each(u.reshape(n, m), v.reshape(n, m)).reshape(-1)

    return Rules(
        frame,
        flow,
        jax.vmap(rules.restore),
        None if rules.log is None else on_points(rules.log),
        None if rules.dexpinv is None else dexpinv,
        on_points(rules.coefficients),
        on_points(rules.sizes),
        free=rules.free,
    )


def _semidirect_rules(frame: Semidirect) -> Rules:
    if not _is_rotation(frame.group):
        raise TypeError(
            f"frame must be a Semidirect of rotations of space in JAX, got {frame!r}; a FieldFrame "
            "takes a flow in jax.numpy"
        )
    return _group_rules(frame)


_MAKERS: dict[type[Frame], Callable[[Any], Rules]] = {
    UnitQuaternion: _rotation_rules,
    SO3: _group_rules,
    SE3: _group_rules,
    SO: _group_rules,
    SU: _group_rules,
    U: _group_rules,
    GL: _group_rules,
    Semidirect: _semidirect_rules,
    Euclidean: _euclidean_rules,
    Sphere: _sphere_rules,
    Stiefel: _stiefel_rules,
    Product: _product_rules,
    Power: _power_rules,
    FieldFrame: _own_rules,
    MatrixFrame: _own_rules,
}
