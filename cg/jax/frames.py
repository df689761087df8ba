"""The functions of each frame in JAX: they take one point, and `jax.vmap` applies them to many.

Coefficients have shape ``(dim,)``, points ``point_shape``, and results the type of the point that
they are made of: float32 or float64, complex64 or complex128. All are smooth wherever the
mathematics is, at coefficients zero and at equal points too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp

from cg import frames
from cg.frames import Frame
from cg.frames.base import check_frame
from cg.jax.groups import group_rules, quaternion_rules, semidirect_rules
from cg.jax.manifolds import (
    conjugation_rules,
    euclidean_rules,
    hyperbolic_rules,
    sphere_rules,
    stiefel_rules,
    user_rules,
)
from cg.jax.products import power_rules, product_rules
from cg.jax.rules import JaxArray, Rules, read_point, real_dtype


def rules_of(frame: Frame) -> Rules:
    """Return the functions of a frame in JAX; TypeError if it has none."""
    check_frame(frame)
    return _rules(frame)


@lru_cache(maxsize=256)
def _rules(frame: Frame) -> Rules:
    make = _MAKERS.get(type(frame))
    if make is None:
        names = ", ".join(kind.__name__ for kind in _MAKERS)
        raise TypeError(
            f"frame must be one of {names} in JAX, got {frame!r}; a FieldFrame takes a flow in "
            "jax.numpy"
        )
    return make(frame)


_GROUPS = (frames.SO3, frames.SO, frames.SU, frames.U, frames.GL, frames.SL, frames.Sp)

_MAKERS: dict[type[Frame], Callable[[Any], Rules]] = {
    frames.UnitQuaternion: quaternion_rules,
    **dict.fromkeys(_GROUPS, group_rules),
    frames.SE3: semidirect_rules,
    frames.Semidirect: semidirect_rules,
    frames.Euclidean: euclidean_rules,
    frames.Sphere: sphere_rules,
    frames.Stiefel: stiefel_rules,
    **dict.fromkeys([frames.Grassmann, frames.SPD, frames.IsospectralOrbit], conjugation_rules),
    frames.Hyperbolic: hyperbolic_rules,
    frames.Product: lambda frame: product_rules(frame, [*map(rules_of, frame.factors)]),
    frames.Power: lambda frame: power_rules(frame, rules_of(frame.factor)),
    **dict.fromkeys([frames.FieldFrame, frames.MatrixFrame, frames.LinearAction], user_rules),
}


def flow(frame: Frame, v: JaxArray, y: JaxArray) -> JaxArray:
    """Return the end of the time-1 flow with coefficients v: `cg.frames.Frame.flow` in JAX.

    Its derivatives, of any order, are right at v = 0 as well. It takes one v and one point.

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
    """Return coefficients whose flow takes one point to another, shape ``(dim,)``.

    As `cg.frames.Frame.exp_coordinates`; the derivatives are right at equal points too, so that
    ``(log(frame, y0, y1)**2).sum()`` is a cost to minimise.

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
    r"""Return the derivatives of a cost along the fields of a frame, shape ``(dim,)``.

    ``jax.grad`` with respect to a point y gives an array g with a number for each entry, as if
    entries could change one by one. The result is :math:`\langle g, E_i(y) \rangle`.

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


def turning(frame: Frame, v: JaxArray) -> JaxArray:
    """Return the angle of a flow, as ``turning`` in ``fortran/frames/frames.f90``."""
    if isinstance(frame, frames.Product):
        factors = zip(frame.factors, frame._vector_slices, strict=True)
        return jnp.stack([turning(factor, v[slot]) for factor, slot in factors]).max()
    if isinstance(frame, frames.Power):
        return jax.vmap(lambda u: turning(frame.factor, u))(v.reshape(frame.n, -1)).max()
    group = getattr(frame, "group", frame)
    if not isinstance(group, frames.SO | frames.SU | frames.U | frames.UnitQuaternion):
        return jnp.zeros((), v.dtype)
    factor = 2.0 if isinstance(group, frames.SO) and group.n > 3 else 1.0
    return jnp.sqrt(factor * (v[: group.dim] @ v[: group.dim]))
