"""What each frame is in JAX: functions of one point, which `jax.vmap` makes ones of many.

Coefficients have shape ``(dim,)``, points ``point_shape``, and results the type of the point that
they are made of: float32 or float64, complex64 or complex128. All are smooth wherever the
mathematics is, at coefficients zero and at equal points too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from cg import frames
from cg.frames import Frame
from cg.frames.base import check_frame
from cg.jax.groups import group_rules, quaternion_rules, semidirect_rules
from cg.jax.manifolds import (
    conjugation_rules,
    euclidean_rules,
    hyperbolic_rules,
    own_rules,
    sphere_rules,
    stiefel_rules,
)
from cg.jax.products import power_rules, product_rules
from cg.jax.rules import Rules


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
