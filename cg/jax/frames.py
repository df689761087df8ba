"""What each frame is in JAX: functions of one point, which `jax.vmap` makes ones of many.

Coefficients have shape ``(dim,)``, points ``point_shape``, and results the type of the point that
they are made of: float32 or float64, complex64 or complex128. All are smooth wherever the
mathematics is, at coefficients zero and at equal points too. Rotations and poses of jaxlie become
points of frames, and back.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar

import jax.numpy as jnp

from cg import frames
from cg.frames import SE3, SO3, Euclidean, Frame, Product, UnitQuaternion
from cg.frames.base import check_frame
from cg.jax.entire import JaxArray
from cg.jax.groups import group_rules, quaternion_of, quaternion_rules, semidirect_rules
from cg.jax.manifolds import (
    conjugation_rules,
    euclidean_rules,
    hyperbolic_rules,
    own_rules,
    sphere_rules,
    stiefel_rules,
)
from cg.jax.products import join, power_rules, product_rules, split
from cg.jax.rules import Rules, linear, read_point


def rules_of(frame: Frame) -> Rules:
    """Return the functions of a frame in JAX; TypeError if it has none."""
    check_frame(frame)
    return _rules(frame)


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
    **dict.fromkeys([frames.FieldFrame, frames.MatrixFrame, frames.LinearAction], own_rules),
}


_T = TypeVar("_T")


def from_jaxlie(frame: Frame, pose: Any) -> JaxArray:
    """Return a rotation or a pose of jaxlie as a point, shape ``frame.point_shape``.

    Parameters
    ----------
    frame
        `cg.frames.UnitQuaternion` or `cg.frames.SO3` for a ``jaxlie.SO3``; `cg.frames.SE3` or
        ``Product(UnitQuaternion(), Euclidean(3))`` for a ``jaxlie.SE3``.
    pose
        A single one, not a batch (``jax.vmap`` takes a batch); any object with the attribute
        ``wxyz`` or ``wxyz_xyz``.

    Notes
    -----
    Twists of ``jaxlie.SE3`` are (v, ω), those of `cg.frames.SE3` (ω, v): ``jnp.roll(twist, 3)``
    makes either of the other. ``jaxlie``'s ``T @ SE3.exp(twist)`` is the flow of ``SE3("body")``,
    and ``SE3.exp(twist) @ T`` that of ``SE3("space")``.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import crouch_grossman as cg
    >>> turned = SimpleNamespace(wxyz=jnp.array([0.0, 0.0, 0.0, 1.0]))
    >>> cg.jax.from_jaxlie(cg.frames.UnitQuaternion(), turned).tolist()
    [0.0, 0.0, 1.0, 0.0]
    >>> jnp.diagonal(cg.jax.from_jaxlie(cg.frames.SO3(), turned)).tolist()
    [-1.0, -1.0, 1.0]
    """
    attribute, size = _attribute(frame)
    numbers = getattr(pose, attribute, None)
    if numbers is None:
        raise TypeError(f"pose must have the attribute {attribute} for {frame!r}, got {pose!r}")
    numbers = jnp.asarray(numbers)
    if numbers.shape != (size,):
        raise ValueError(f"{attribute} must have shape ({size},), got {numbers.shape}")
    wxyz, position = numbers[:4], numbers[4:]
    if isinstance(frame, Product):
        return join(frame, _rolled(frame.factors[0], wxyz, -1), position)
    if isinstance(frame, UnitQuaternion):
        return _rolled(frame, wxyz, -1)
    wedge = linear(wxyz[1:], SO3().basis)
    rotation = jnp.eye(3, dtype=wxyz.dtype) + 2.0 * (wxyz[0] * wedge + wedge @ wedge)
    if isinstance(frame, SO3):
        return rotation
    upper = jnp.concatenate([rotation, position[:, None]], axis=1)
    return jnp.eye(4, dtype=rotation.dtype).at[:3].set(upper)


def to_jaxlie(frame: Frame, y: JaxArray, kind: Callable[[JaxArray], _T]) -> _T:
    """Return a point of a frame as a rotation or a pose of jaxlie.

    Parameters
    ----------
    frame
        As of `from_jaxlie`.
    y
        A point, shape ``frame.point_shape``.
    kind
        ``jaxlie.SO3`` or ``jaxlie.SE3``, called with the numbers (w, x, y, z) of the quaternion,
        and those of the position behind them; w is not negative if the point is a matrix.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.jax.to_jaxlie(cg.frames.SE3(), jnp.eye(4), list)[0].tolist()
    1.0
    """
    _, size = _attribute(frame)
    count = getattr(kind, "parameters_dim", size)
    if count != size:
        raise TypeError(
            f"kind must have {size} parameters for {frame!r}, got {kind!r}, with {count}"
        )
    y = read_point(frame, y)
    if isinstance(frame, Product):
        quaternion, position = split(frame, y)
        return kind(jnp.concatenate([_rolled(frame.factors[0], quaternion, 1), position]))
    if isinstance(frame, UnitQuaternion):
        return kind(_rolled(frame, y, 1))
    wxyz = jnp.roll(quaternion_of(y[:3, :3] - jnp.eye(3, dtype=y.dtype)), 1)
    return kind(wxyz if isinstance(frame, SO3) else jnp.concatenate([wxyz, y[:3, 3]]))


def _attribute(frame: Frame) -> tuple[str, int]:
    """Return the name and the length of the array of the type of jaxlie for a frame."""
    if isinstance(frame, UnitQuaternion | SO3):
        return "wxyz", 4
    factors = frame.factors if isinstance(frame, Product) else ()
    pose = len(factors) == 2 and isinstance(factors[0], UnitQuaternion)
    if isinstance(frame, SE3) or (pose and factors[1] == Euclidean(3)):
        return "wxyz_xyz", 7
    hint = "; cg.jax.join makes its point of the parts" if isinstance(frame, Product) else ""
    raise TypeError(
        "frame must be UnitQuaternion, SO3, SE3 or Product(UnitQuaternion(), Euclidean(3)), "
        f"got {frame!r}{hint}"
    )


def _rolled(frame: Any, quaternion: JaxArray, places: int) -> JaxArray:
    """Return a quaternion, its components moved if the frame has the scalar last."""
    return quaternion if frame.scalar_first else jnp.roll(quaternion, places)
