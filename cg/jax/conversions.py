"""Points of jaxlie as points of frames, and back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax.numpy as jnp

from cg.frames import SE3, SO3, Euclidean, Frame, Product, UnitQuaternion
from cg.jax.entire import JaxArray
from cg.jax.products import join, split
from cg.jax.rotation_rules import quaternion_of
from cg.jax.rules import read_point

_T = TypeVar("_T")


def from_jaxlie(frame: Frame, pose: Any) -> JaxArray:
    """Return a rotation or a pose of jaxlie as a point of a frame.

    Parameters
    ----------
    frame
        `cg.frames.UnitQuaternion` or `cg.frames.SO3` for a ``jaxlie.SO3``; `cg.frames.SE3` or
        ``Product(UnitQuaternion(), Euclidean(3))`` for a ``jaxlie.SE3``.
    pose
        A single one, not a batch (``jax.vmap`` takes a batch); any object with the attribute
        ``wxyz`` or ``wxyz_xyz``.

    Returns
    -------
    array
        Shape ``frame.point_shape``.

    Raises
    ------
    TypeError
        If ``frame`` is none of these, or ``pose`` lacks the attribute.
    ValueError
        If the array of ``pose`` has another shape, such as that of a batch.

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
        return join(frame, _ordered(frame.factors[0], wxyz), position)
    if isinstance(frame, UnitQuaternion):
        return _ordered(frame, wxyz)
    rotation = _matrix(wxyz)
    if isinstance(frame, SO3):
        return rotation
    return (
        jnp.eye(4, dtype=rotation.dtype)
        .at[:3]
        .set(jnp.concatenate([rotation, position[:, None]], axis=1))
    )


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
        and those of the position behind them.

    Returns
    -------
    object
        What ``kind`` returns. Of a matrix, w is not negative.

    Raises
    ------
    TypeError
        If ``frame`` is none of those of `from_jaxlie`, or ``kind`` is the other type of jaxlie.
    ValueError
        If ``y`` has another shape.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.jax.to_jaxlie(cg.frames.SE3(), jnp.eye(4), list)[0].tolist()
    1.0
    """
    _, size = _attribute(frame)
    given = getattr(kind, "parameters_dim", size)
    if given != size:
        raise TypeError(
            f"kind must have {size} parameters for {frame!r}, got {kind!r}, with {given}"
        )
    y = read_point(frame, y)
    if isinstance(frame, Product):
        quaternion, position = split(frame, y)
        return kind(jnp.concatenate([_wxyz(frame.factors[0], quaternion), position]))
    if isinstance(frame, UnitQuaternion):
        return kind(_wxyz(frame, y))
    wxyz = jnp.roll(quaternion_of(y[:3, :3] - jnp.eye(3, dtype=y.dtype)), 1)
    return kind(wxyz if isinstance(frame, SO3) else jnp.concatenate([wxyz, y[:3, 3]]))


def _attribute(frame: Frame) -> tuple[str, int]:
    """Return the name of the array of the type of jaxlie that a frame goes with, and its length."""
    if isinstance(frame, UnitQuaternion | SO3):
        return "wxyz", 4
    pose = isinstance(frame, Product) and (
        len(frame.factors) == 2
        and isinstance(frame.factors[0], UnitQuaternion)
        and frame.factors[1] == Euclidean(3)
    )
    if isinstance(frame, SE3) or pose:
        return "wxyz_xyz", 7
    hint = "; cg.jax.join makes its point of the parts" if isinstance(frame, Product) else ""
    raise TypeError(
        "frame must be UnitQuaternion, SO3, SE3 or Product(UnitQuaternion(), Euclidean(3)), "
        f"got {frame!r}{hint}"
    )


def _scalar_first(frame: Frame) -> bool:
    assert isinstance(frame, UnitQuaternion)
    return frame.scalar_first


def _ordered(frame: Frame, wxyz: JaxArray) -> JaxArray:
    return wxyz if _scalar_first(frame) else jnp.roll(wxyz, -1)


def _wxyz(frame: Frame, quaternion: JaxArray) -> JaxArray:
    return quaternion if _scalar_first(frame) else jnp.roll(quaternion, 1)


def _matrix(wxyz: JaxArray) -> JaxArray:
    w, x, y, z = wxyz
    return jnp.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
