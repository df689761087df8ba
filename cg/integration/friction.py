"""Whether forces depend on the momentum, which splitting methods can't integrate.

Each look calls ``f`` twice at one position; these calls aren't part of the integration, and its
counts leave them out. So a finite number of members and points is looked at.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.phase_space import PhaseSpace
from cg.integration.rhs.python import PythonRhs
from cg.support.arrays import Array, Points
from cg.tables import Kind

_MOST, _LEAST = 32, 4  # members or points that are looked at
_SHARE = 40  # evaluations of an integration for each call of a look at its points
_ROUNDING = 1e-12  # relative, of equal forces


def _sample(count: int, most: int = _MOST) -> NDArray[np.intp]:
    """Return all of ``count`` places, or ``most`` of them, evenly distributed with both ends."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)


def refuse_friction(plan: Any, rhs: Any, t: float, points: Points, ahead: bool = False) -> None:
    """Raise ValueError if a force on a sample of members, at points of each, is friction.

    Exceptions of ``f`` count in the first member only, and not ahead of the integration.
    """
    if plan.method.kind is not Kind.SPLITTING:
        return
    members = _sample(len(points))
    first = 0 if ahead else 1
    if first:
        _check(plan.frame, rhs, np.array([t]), members[:1], points[:1], False)
    if len(members) > first:
        rest = members[first:]
        _check(plan.frame, rhs, np.full(len(rest), t), rest, points[rest], True)


def refuse_friction_along(plan: Any, rhs: Any, times: Array, points: Points, nfev: int) -> None:
    """Raise ValueError if a force is friction at a sample of the points of a solution.

    Points have the shape ``(times, members, *point_shape)``; the solution took ``nfev`` calls.
    """
    if plan.method.kind is not Kind.SPLITTING or not isinstance(plan.frame, PhaseSpace):
        return
    most = max(_LEAST, min(_MOST, nfev // (2 * _SHARE)))
    k, members = np.divmod(_sample(points.shape[0] * points.shape[1], most), points.shape[1])
    reached = np.isfinite(points[k, members]).all(axis=-1)  # not those behind an early end
    k, members = k[reached], members[reached]
    if len(k):
        _check(plan.frame, rhs, times[k], members, points[k, members], True)


def _check(
    frame: PhaseSpace, rhs: Any, t: Array, members: NDArray[np.intp], y: Points, lenient: bool
) -> None:
    """Compare forces at points with those of other momenta; ``lenient`` ignores exceptions."""
    q, momentum = frame.split(y)
    shift = np.sqrt(np.arange(2.0, 2.0 + frame.rhs_dim))
    other = frame.join(q, momentum + shift * (1.0 + np.abs(momentum)))
    try:
        one, another = (_forces(rhs, t, members, points) for points in (y, other))
    except Exception as error:
        if lenient:
            return
        if isinstance(rhs, PythonRhs) and not rhs.vectorized:
            error.add_note(rhs.note(float(t[0])))
        raise
    scale = np.abs(one).max(axis=-1, keepdims=True, initial=0.0)
    differs = ~(np.abs(one - another) <= _ROUNDING * scale)
    if lenient:
        differs &= ~(np.isnan(one) & np.isnan(another))
    if differs.any():
        k = int(np.flatnonzero(differs.any(axis=-1))[0])
        first = getattr(rhs, "first", None)
        which = "" if first is None else f" in member {first + members[k]}"
        raise ValueError(
            "f must not depend on the momentum with a splitting method, whose kicks are not "
            f"symplectic then, got other forces for another momentum at t = {t[k]:.17g}{which}; "
            "adaptive methods, the default among them, take friction"
        )


def _forces(rhs: Any, t: Array, members: NDArray[np.intp], y: Points) -> Array:
    """Return what ``f`` returns for several members, in one call if it is vectorized."""
    if isinstance(rhs, PythonRhs) and rhs.vectorized:
        return np.array(rhs.at_members(t.copy(), members, y.copy()))
    each = zip(members.tolist(), t.tolist(), y, strict=True)
    return np.array([rhs.answer(member, time, point) for member, time, point in each])
