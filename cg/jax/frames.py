"""What each frame is in JAX: functions of one point, which `jax.vmap` makes ones of many.

Coefficients have shape ``(dim,)``, points ``point_shape``, and results the type of the point that
they are made of: float32 or float64, complex64 or complex128. All are smooth wherever the
mathematics is, at coefficients zero and at equal points too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from cg.frames import (
    GL,
    SE3,
    SL,
    SO,
    SO3,
    SPD,
    SU,
    Euclidean,
    FieldFrame,
    Frame,
    Grassmann,
    Hyperbolic,
    IsospectralOrbit,
    LinearAction,
    MatrixFrame,
    Power,
    Product,
    Semidirect,
    Sp,
    Sphere,
    Stiefel,
    U,
    UnitQuaternion,
)
from cg.jax.groups import group_rules, semidirect_rules
from cg.jax.manifolds import (
    conjugation_rules,
    euclidean_rules,
    hyperbolic_rules,
    own_rules,
    sphere_rules,
    stiefel_rules,
)
from cg.jax.products import power_rules, product_rules
from cg.jax.rotation_rules import quaternion_rules
from cg.jax.rules import Rules


def rules_of(frame: Frame) -> Rules:
    """Return the functions of a frame in JAX; TypeError if it has none."""
    if not isinstance(frame, Frame):
        raise TypeError(f"frame must be a cg.frames.Frame, got {frame!r}")
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


_MAKERS: dict[type[Frame], Callable[[Any], Rules]] = {
    UnitQuaternion: quaternion_rules,
    SO3: group_rules,
    SE3: group_rules,
    SO: group_rules,
    SU: group_rules,
    U: group_rules,
    GL: group_rules,
    SL: group_rules,
    Sp: group_rules,
    Semidirect: semidirect_rules,
    Euclidean: euclidean_rules,
    Sphere: sphere_rules,
    Stiefel: stiefel_rules,
    Grassmann: conjugation_rules,
    SPD: conjugation_rules,
    IsospectralOrbit: conjugation_rules,
    Hyperbolic: hyperbolic_rules,
    Product: lambda frame: product_rules(frame, [rules_of(part) for part in frame.factors]),
    Power: lambda frame: power_rules(frame, rules_of(frame.factor)),
    FieldFrame: own_rules,
    MatrixFrame: own_rules,
    LinearAction: own_rules,
}
