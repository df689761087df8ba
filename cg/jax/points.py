"""Flows, logarithms and cotangents of frames in JAX."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cg.frames import (
    SL,
    SO,
    SPD,
    SU,
    Frame,
    Grassmann,
    Hyperbolic,
    IsospectralOrbit,
    Power,
    Product,
    Semidirect,
    Sp,
    Sphere,
    Stiefel,
    U,
    UnitQuaternion,
)
from cg.jax.entire import JaxArray
from cg.jax.frames import rules_of
from cg.jax.products import split
from cg.jax.rules import adjoint, read_point, real_dtype


def flow(frame: Frame, v: JaxArray, y: JaxArray) -> JaxArray:
    """Return the time-1 flow of the field with coefficients v: `cg.frames.Frame.flow` in JAX.

    Its derivatives, of any order, are right at v = 0 as well.

    Parameters
    ----------
    frame
        A frame that `cg.jax` supports.
    v
        Coefficients, shape ``(dim,)``.
    y
        A point, shape ``point_shape``.

    Returns
    -------
    array
        Shape ``point_shape``.

    Raises
    ------
    TypeError
        If ``frame`` is no frame that JAX has functions for.
    ValueError
        If a shape doesn't fit.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.Sphere(2)
    >>> cg.jax.flow(frame, jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])).tolist()
    [0.0, 0.0, 1.0]
    """
    rules = rules_of(frame)
    v, y = jnp.asarray(v), read_point(frame, y, "y")
    if v.shape != (frame.dim,):
        raise ValueError(f"v must have shape ({frame.dim},), got {v.shape}")
    return rules.restore(rules.flow(v.astype(real_dtype(y)), y))


def log(frame: Frame, y0: JaxArray, y1: JaxArray) -> JaxArray:
    """Return coefficients whose flow takes one point to another.

    As `cg.frames.Frame.exp_coordinates`; the derivatives are right at equal points too, so that
    ``(log(frame, y0, y1)**2).sum()`` is a cost to minimise.

    Parameters
    ----------
    frame
        A frame that `cg.jax` supports.
    y0, y1
        Points, shape ``point_shape``.

    Returns
    -------
    array
        Shape ``(dim,)``.

    Raises
    ------
    TypeError
        If ``frame`` is no frame that JAX has functions for.
    ValueError
        If a shape doesn't fit, or the frame has no such coordinates.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.UnitQuaternion()
    >>> start = jnp.array([0.0, 0.0, 0.0, 1.0])
    >>> turned = cg.jax.flow(frame, jnp.array([0.0, 0.0, 0.5]), start)
    >>> [round(float(v), 6) for v in cg.jax.log(frame, start, turned)]
    [0.0, 0.0, 0.5]
    """
    rules = rules_of(frame)
    if rules.log is None:
        raise ValueError(f"frame must have exp_coordinates, got {frame!r}")
    return rules.log(read_point(frame, y0, "y0"), read_point(frame, y1, "y1"))


def cotangent(frame: Frame, y: JaxArray, g: JaxArray) -> JaxArray:
    r"""Return an ambient cotangent, such as a gradient by entries, as one by coordinates.

    ``jax.grad`` with respect to a point gives a number for each entry, as if entries could change
    one by one. The result says how the cost changes along the fields of the frame, :math:`\langle
    g, E_i(y) \rangle`.

    Parameters
    ----------
    frame
        A frame that `cg.jax` supports.
    y
        A point, shape ``point_shape``.
    g
        The gradient with respect to it that ``jax.grad`` gives, shape ``point_shape``.

    Returns
    -------
    array
        Shape ``(dim,)``.

    Raises
    ------
    TypeError
        If ``frame`` is no frame that JAX has functions for.
    ValueError
        If a shape doesn't fit.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.Sphere(2)
    >>> north, g = jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 5.0])
    >>> [float(x) for x in cg.jax.cotangent(frame, north, g)]
    [0.0, 1.0, 0.0]
    """
    rules = rules_of(frame)
    y, g = read_point(frame, y, "y"), read_point(frame, g, "g")
    zero = jnp.zeros(frame.dim, real_dtype(y))
    _, pull = jax.vjp(lambda v: rules.flow(v, y), zero)
    return pull(g.astype(y.dtype))[0]


def membership_error(frame: Frame, y: JaxArray) -> JaxArray:
    """Return the residuals of a manifold's equations, to first order its `relative_error`."""
    if isinstance(frame, Product):
        parts = zip(frame.factors, split(frame, y), strict=True)
        return jnp.stack([membership_error(factor, part) for factor, part in parts]).max()
    if isinstance(frame, Power):
        return jax.vmap(lambda part: membership_error(frame.factor, part))(y).max()
    if isinstance(frame, Semidirect):
        n = frame.group.size
        lower = jnp.abs(y[n:] - jnp.eye(len(y))[n:]).max()
        return jnp.maximum(membership_error(frame.group, y[:n, :n]), lower)
    if isinstance(frame, UnitQuaternion | Sphere):
        return jnp.abs(jnp.sqrt(y @ y) - 1.0)
    if isinstance(frame, Hyperbolic):
        return jnp.where(y[-1] > 0.0, 0.0, 1.0 - y[-1])
    return _matrix_error(frame, y)


def _matrix_error(frame: Frame, y: JaxArray) -> JaxArray:
    """Return the relative distance of a matrix from its manifold, zero where all are on it."""
    if isinstance(frame, SO | SU | U | Stiefel):
        error = 0.5 * jnp.abs(adjoint(y) @ y - jnp.eye(y.shape[1])).max()
        if isinstance(frame, SO | SU):
            error = jnp.maximum(error, jnp.abs(jnp.linalg.det(y) - 1.0))
        return error
    if isinstance(frame, SL | Sp):
        return jnp.linalg.norm(rules_of(frame).restore(y) - y, 2) / jnp.linalg.norm(y, 2)
    if not isinstance(frame, Grassmann | SPD | IsospectralOrbit):
        return jnp.zeros((), real_dtype(y))
    values, asymmetry = jnp.linalg.eigvalsh(y), jnp.abs(y - adjoint(y)).max()
    if isinstance(frame, SPD):
        return jnp.maximum(asymmetry, -values[0]) / jnp.abs(y).max()
    if isinstance(frame, Grassmann):
        spectrum = np.repeat([0.0, 1.0], [frame.n - frame.k, frame.k])
    else:
        spectrum = np.array(frame.spectrum)
    error = jnp.maximum(0.5 * asymmetry, jnp.abs(values - spectrum).max())
    return error / (np.abs(spectrum).max() or 1.0)
