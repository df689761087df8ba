"""The functions of a frame in JAX (`Rules`), and functions that several frames use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from cg.frames import Frame
from cg.support.arrays import Array

JaxArray = Any  # jax.Array or a tracer; its operators are untyped

Scalars = Sequence[JaxArray]
Map = Callable[[JaxArray], JaxArray]
Pairing = Callable[[JaxArray, JaxArray], JaxArray]
Dexpinv = Callable[[JaxArray, JaxArray, int], JaxArray]

_LOCAL_STEPS = 4  # Gauss-Newton steps of `local_coordinates`


def same(y: JaxArray) -> JaxArray:
    """Return the point itself."""
    return y


def zero(y: JaxArray) -> JaxArray:
    """Return the relative error of a point of a manifold that is the whole space."""
    return jnp.zeros((), real_dtype(y))


@dataclass(frozen=True, eq=False)
class Rules:
    """A frame as functions of JAX.

    ``flow(v, y)`` leaves rounding errors, which ``restore(y)`` removes. ``log(y0, y1)`` returns the
    coefficients whose flow takes one point to the other; it is None where the frame has no
    `cg.frames.Frame.exp_coordinates`. ``dexpinv(u, v, order)`` is that of the frame, None without
    brackets. ``closed_coefficients(y, tangent)`` and ``closed_field(v, y)`` are `coefficients` and
    `field` in closed form, ``unequal_sizes(y)`` `sizes` where not all are 1. ``relative_error(y)``
    is, to first order, the `cg.frames.Frame.relative_error` of a point off the manifold. ``unique``
    says whether two points determine the coefficients of the short flow between them.
    `local_coordinates` starts at ``first_coordinates(y0, y1)``, None for zero. ``composed(flows)``
    are the coefficients of the flow that is the product of flows, shape ``(count, dim)``, the first
    one first; None where points determine it well.
    """

    frame: Frame
    flow: Pairing
    restore: Map = same
    log: Pairing | None = None
    dexpinv: Dexpinv | None = None
    closed_coefficients: Pairing | None = None
    unequal_sizes: Map | None = None
    relative_error: Map = zero
    unique: bool = True
    first_coordinates: Pairing | None = None
    composed: Map | None = None
    closed_field: Pairing | None = None

    def coefficients(self, y: JaxArray, tangent: JaxArray) -> JaxArray:
        """Return the shortest coefficients whose field is nearest to a tangent."""
        if self.closed_coefficients is not None:
            return self.closed_coefficients(y, tangent)
        dim = self.frame.dim
        columns = jax.jacfwd(lambda v: self.flow(v, y))(jnp.zeros(dim, real_dtype(y)))
        columns, flat = columns.reshape(-1, dim), tangent.reshape(-1)
        if jnp.iscomplexobj(columns):
            columns = jnp.concatenate([columns.real, columns.imag])
            flat = jnp.concatenate([flat.real, flat.imag])
        return jnp.linalg.pinv(columns) @ flat

    def sizes(self, y: JaxArray) -> JaxArray:
        """Return `cg.frames.Frame.coordinate_sizes`, shape ``(dim,)``."""
        if self.unequal_sizes is not None:
            return self.unequal_sizes(y)
        return jnp.ones(self.frame.dim, real_dtype(y))

    def field(self, v: JaxArray, y: JaxArray) -> JaxArray:
        """Return the tangent at ``y``: the derivative of the flow."""
        if self.closed_field is not None:
            return self.closed_field(v, y)
        return jax.jvp(lambda w: self.flow(w, y), (jnp.zeros_like(v),), (v,))[1]

    def local_coordinates(self, y0: JaxArray, y1: JaxArray) -> JaxArray:
        """Return coefficients whose flow takes ``y0`` to a point near it, for any frame."""
        if self.log is not None:
            return self.log(y0, y1)
        first = self.first_coordinates
        v = first(y0, y1) if first else jnp.zeros(self.frame.dim, real_dtype(y0))
        for _ in range(_LOCAL_STEPS):
            y = self.flow(v, y0)
            v = v + self.coefficients(y, y1 - y)
        return v

    def measured(self, v: JaxArray, y: JaxArray) -> JaxArray:
        """Return an error as controllers measure it: shortest coefficients, or tangent entries."""
        if self.log is not None and self.unique:
            return v
        tangent = self.field(v, y)
        return tangent if self.log is None else self.coefficients(y, tangent)

    def measured_sizes(self, y: JaxArray) -> JaxArray:
        """Return the sizes to which errors in `measured` are relative, in the same shape."""
        if self.log is not None:
            return self.sizes(y)
        return jnp.full(y.shape, jnp.sqrt((jnp.abs(y) ** 2).mean()))

    def extent(self, x: JaxArray, y: JaxArray) -> JaxArray:
        """Return the sizes of errors for a step between two points: the larger of those at both."""
        return jnp.maximum(self.measured_sizes(x), self.measured_sizes(y))


def real_dtype(y: JaxArray) -> Any:
    """Return the type of the real part of an array."""
    return jnp.finfo(jnp.result_type(y)).dtype


def read_point(frame: Frame, y: Any, name: str = "y") -> JaxArray:
    """Return a point as an array of the kind of the frame; raise ValueError for another shape."""
    point = jnp.asarray(y)
    if point.shape != frame.point_shape:
        raise ValueError(f"{name} must have shape {frame.point_shape}, got {point.shape}")
    if frame.dtype.kind == "c":
        return point.astype(jnp.result_type(point, jnp.complex64))
    return point if jnp.issubdtype(point.dtype, jnp.floating) else point.astype(float)


def with_identity_derivative(restore: Map) -> Map:
    """Return a function with the derivative of the identity, that of `restore` along a manifold.

    Derivatives of the decompositions in it don't exist where eigenvalues are equal.
    """
    return lambda y: y + jax.lax.stop_gradient(restore(y) - y)


def linear(v: JaxArray, basis: NDArray[Any]) -> JaxArray:
    """Return the combination of matrices with real coefficients, in their precision."""
    dtype = v.dtype if basis.dtype.kind == "f" else jnp.result_type(v.dtype, np.complex64)
    flat = jnp.asarray(basis.reshape(len(basis), -1), dtype)
    return (v.astype(dtype) @ flat).reshape(basis.shape[1:])


def act(v: JaxArray, basis: Array, y: JaxArray) -> JaxArray:
    """Return the combination of real matrices times a vector, its field on vectors.

    The products with the vector come first, since stages of a step share them. `XLA` makes sums
    part of other kernels, unlike products of small matrices.
    """
    fields = (jnp.asarray(basis, y.dtype) * y).sum(axis=2)
    return (v[:, None] * fields).sum(axis=0)


def bilinear(tensor: NDArray[Any], x: Scalars, y: Scalars) -> list[JaxArray]:
    """Return the sums over i, j of ``tensor[k, i, j] * x[i] * y[j]``, without terms that are zero.

    `XLA` makes one kernel of such scalars and of what is computed from them; products of small
    matrices and ``jnp.cross`` are several.
    """
    return [
        sum(float(slab[i, j]) * (x[i] * y[j]) for i, j in np.argwhere(slab).tolist())
        for slab in tensor
    ]


def cross(x: Scalars, y: Scalars) -> list[JaxArray]:
    """Return the cross product, from scalars to scalars as `bilinear`."""
    return [x[k - 2] * y[k - 1] - x[k - 1] * y[k - 2] for k in range(3)]


def dot(x: Scalars, y: Scalars) -> JaxArray:
    """Return the scalar product, from scalars as `bilinear`."""
    return sum(a * b for a, b in zip(x, y, strict=True))


def unit_step(y: JaxArray) -> JaxArray:
    """Return a vector with a length nearer to 1: a step of Newton's method."""
    return (1.5 - 0.5 * (y @ y)) * y


def length_error(y: JaxArray) -> JaxArray:
    """Return the distance of a vector from the sphere."""
    return jnp.abs(jnp.sqrt(y @ y) - 1.0)


def adjoint(y: JaxArray) -> JaxArray:
    """Return the conjugate transpose."""
    return y.T.conj()


def column_error(y: JaxArray) -> JaxArray:
    """Return the distance of a matrix from those with orthonormal columns."""
    return 0.5 * jnp.abs(adjoint(y) @ y - jnp.eye(y.shape[1])).max()
