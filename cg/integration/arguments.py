"""Checks of arguments that the integrations share: points, times, tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg import _core_r64 as core
from cg.frames.base import Frame
from cg.integration.plan.plan import Plan
from cg.support.arrays import Array, Points, check_finite, clipped, is_array, real_array
from cg.support.checks import check_number, short, texts_of, warn_user
from cg.support.shared_numbers import StageLimit

DEFAULT_MAX_STEPS = 10**6
"""Limit of the number of adaptive steps, rejected ones included."""

STAGE_SOLVERS = {"newton": int(StageLimit.NEWTON), "fixed-point": int(StageLimit.FIXED_POINT)}
"""The iterations for implicit stages, and their limits."""

DEFAULT_RTOL, DEFAULT_ATOL = np.array(1e-3), np.array(1e-6)
_NUMBERS = {float, int}
_MIN_RTOL = 100.0 * float(np.finfo(np.float64).eps)
_MAX_STEPS = 2**53  # a step number must be an exact float, or times would not be distinct


def check_breakpoints(breakpoints: Any, start: float, end: float) -> Array:
    """Return the times at which steps end: the breakpoints inside the span, then its end."""
    if breakpoints is None:
        return np.array([end])
    times = check_times("breakpoints", breakpoints, "between the ends,", start, end)
    check_finite("breakpoints", times)
    return np.append(times[(times != start) & (times != end)], end)


def check_times(name: str, value: Any, where: str, start: float, end: float) -> Array:
    """Return times after checking that they are sorted and lie between two times.

    Times that are beyond an end by a few roundings are moved to it.
    """
    times = real_array(value, name)
    if times.ndim != 1:
        raise ValueError(f"{name} must have one axis, got shape {times.shape}")
    low, high = min(start, end), max(start, end)
    inside, outside = clipped(times, low, high)
    if outside is not None:
        first, last, got = texts_of(low, high, times[outside])
        raise ValueError(f"{name} must lie {where} {first} to {last}, got {got} at [{outside}]")
    increases = math.copysign(1.0, end - start) * (inside[1:] - inside[:-1]) > 0.0
    if not increases.all():
        index = int(np.argmin(increases))
        before, got = texts_of(*inside[index : index + 2])
        raise ValueError(
            f"{name} must be strictly sorted in the direction of integration, got {got} after "
            f"{before} at [{index + 1}]"
        )
    return inside


def check_args(args: Any) -> tuple[Any, ...]:
    """Return the further arguments of ``f``; TypeError unless they are a sequence."""
    if args is None or type(args) is tuple:
        return args or ()
    try:
        # a set has no order; a string or an array is probably a single argument
        if isinstance(args, str | bytes | bytearray | Set | Mapping | np.ndarray):
            raise TypeError
        return tuple(args)
    except TypeError:
        raise TypeError(
            f"args must be a tuple of further arguments, such as (x,) for one, got {args!r}"
        ) from None


def check_resolution(h: float | None, t: float) -> None:
    """Raise ValueError if a fixed step doesn't change the time."""
    if h is not None and h < math.ulp(t):
        raise ValueError(f"h must change the time at t = {t!r}, got {h!r}")


def check_rtol(rtol: Any) -> Array:
    """Return the relative tolerances; tiny ones are raised with a warning."""
    if type(rtol) is float and _MIN_RTOL <= rtol < math.inf:  # the usual case, in little time
        return np.array(rtol)
    tolerances = check_tolerances("rtol", rtol)
    if tolerances.min() < _MIN_RTOL:
        label = f"rtol = {tolerances:g}" if tolerances.ndim == 0 else "At least one element of rtol"
        warn_user(f"{label} is too small to be attained and is raised to {_MIN_RTOL:.3g}")
    return np.maximum(tolerances, _MIN_RTOL)


def check_tolerances(name: str, value: Any) -> Array:
    """Return one or several tolerances after checking them."""
    if type(value) is float and 0.0 <= value < math.inf:
        return np.array(value)
    several = hasattr(value, "__len__") and not isinstance(value, str)
    tolerances = real_array(value if several else check_number(name, value), name)
    if not tolerances.size or not ((tolerances >= 0.0) & (tolerances < math.inf)).all():
        raise ValueError(f"{name} must be finite and not negative, got {short(value)}")
    return tolerances


def equal_steps(h: float, ends: list[float]) -> int:
    """Return the number of steps of size h between times; ValueError if h is too small."""
    total = 0
    for start, end in pairwise(ends):
        span = abs(end - start)
        if span == 0.0:
            continue
        resolution = math.ulp(max(abs(start), abs(end)))
        if span / h > _MAX_STEPS or (span > h and h < resolution):
            raise ValueError(f"h must lead to distinct times in t_span {(start, end)!r}, got {h!r}")
        total += core.equal_steps(start, end, h)[0]
    return total


def read_initial_members(
    plan: Plan, y0: ArrayLike, parameters: Any, ensemble: bool
) -> tuple[Points, Array | None]:
    """Return initial points and their parameters as new arrays, after checking them.

    For an ``ensemble`` both may have a leading axis of members; a single point serves all rows of
    parameters. The results have the shapes ``(members, *point_shape)`` and ``(members, k)``.
    """
    points = read_starts(plan, y0, ensemble)
    if parameters is None:
        return points, None
    numbers = real_array(parameters, "parameters")
    if not ensemble and numbers.ndim != 1:
        raise ValueError(f"parameters must have shape (k,), got {numbers.shape}")
    rows = numbers if ensemble else numbers[None]
    if len(points) == 1 and rows.ndim == 2:
        points = np.repeat(points, len(rows), axis=0)
    if rows.ndim != 2 or len(rows) != len(points) or rows.size == 0:
        lead = "members" if len(points) == 1 else len(points)
        shape = f"({lead}, k)" if ensemble else "(k,)"
        raise ValueError(f"parameters must have shape {shape}, got {numbers.shape}")
    rows.setflags(write=False)
    return points, rows


def read_points(frame: Frame, y0: ArrayLike, name: str = "y0") -> Points:
    """Return points as an array; the error for parts of a point names ``frame.join``."""
    try:
        return frame.read_points(y0, name)
    except ValueError as error:
        if isinstance(y0, list | tuple) and hasattr(frame, "join"):
            raise ValueError(f"{error}; frame.join makes a point of its parts") from None
        raise


def read_starts(plan: Plan, y0: ArrayLike, ensemble: bool, name: str = "y0") -> Points:
    """Return the points of an ensemble, or a single one, as a new array after checking them."""
    frame, shape = plan.frame, plan.point_shape
    if plan.compiled and is_array(y0, plan.dtype):
        points = y0.copy()
    else:
        points = read_points(frame, y0, name)
    if points.shape == shape and plan.surely_on_manifold(points):
        return points[None]
    axes = len(shape)
    lead = points.shape[: max(points.ndim - axes, 0)]
    if lead and points.shape[len(lead) :] == shape:
        if not ensemble:
            raise ValueError(
                f"{name} must have shape {shape}, got {points.shape}; cg.solve_ensemble "
                "integrates many points"
            )
        if len(lead) != 1:
            raise ValueError(f"{name} must have one axis before shape {shape}, got {points.shape}")
        if points.size == 0:
            raise ValueError(f"{name} must hold at least one point, got shape {points.shape}")
        # only the worst point, or the first that isn't finite, gets the full check
        if not plan.surely_on_manifold(points):
            worst = int(np.argmax(frame.state_error(points)))
            frame.check_point(points[worst], name=f"{name}[{worst}]")
        return points
    frame.check_point(points, name=name)
    return points[None]


def check_span(t_span: Sequence[float]) -> tuple[float, float]:
    """Return initial and final time; ValueError unless they are finite, or the end is infinite."""
    try:
        if type(t_span) is tuple and _NUMBERS.issuperset(map(type, t_span)):
            start, end = map(float, t_span)
        elif isinstance(t_span, Mapping):
            raise ValueError("not a sequence")
        else:
            times = real_array(t_span, "t_span")
            # NumPy would convert a bool among numbers
            if times.shape != (2,) or not {bool, np.bool_}.isdisjoint(map(type, t_span)):
                raise ValueError("not two numbers")
            start, end = times.tolist()
    except (ValueError, OverflowError) as error:
        raise ValueError(f"t_span must be two numbers, got {t_span!r}") from error
    if math.isfinite(end - start):
        return start, end
    if not math.isfinite(start) or math.isnan(end):
        raise ValueError(f"t_span must be two numbers, the first one finite, got {t_span!r}")
    if not math.isinf(end):
        raise ValueError(f"t_span must have a finite length, got {t_span!r}")
    return start, end


def check_real_time(name: str, value: Any, *, infinite: bool = True) -> float:
    """Return a time; TypeError or ValueError if it isn't a number or must be finite."""
    time = check_number(name, value)
    if math.isnan(time) or (math.isinf(time) and not infinite):
        raise ValueError(f"{name} must be a{'' if infinite else ' finite'} number, got {value!r}")
    return time


def is_ensemble(frame: Any, y0: Any) -> bool:
    """Return whether ``y0`` has one axis more than a point; its values are checked later."""
    if not isinstance(frame, Frame):
        return False
    try:
        return np.ndim(frame.read_points(y0, "y0")) > len(frame.point_shape)
    except (TypeError, ValueError):
        return False
