"""Plots of an attitude over time."""

from __future__ import annotations

from collections.abc import Sized
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.rotations import is_rotation
from cg.plot.drawn_rotations import drawn_rotations, rotations_of
from cg.plot.style import COLOURS, axes_for, members_of, opacity_of
from cg.support.arrays import check_finite, real_array
from cg.support.checks import check_flag

_SEQUENCES = {"".join(axes) for axes in permutations("xyz")} | {
    a + b + a for a in "xyz" for b in "xyz" if a != b
}
_DASHES = ("-", "--", "-.")
_ORDER = ("first", "second", "third")
_AIRCRAFT = ("yaw", "pitch", "roll")


def attitude(
    y: Any,
    ax: Any = None,
    *,
    show: str = "ZYX",
    t: Any = None,
    reference: Any = None,
    wrap: bool = False,
) -> Any:
    """Draw angles of an attitude, its angular velocity or its error against time.

    Parameters
    ----------
    y
        A solution on `SO3`, `UnitQuaternion`, `SE3` or a product with one of them, rotations,
        matrices of shape ``(n, 3, 3)``, or quaternions of shape ``(n, 4)``, scalar last. A
        solution with dense output is drawn between its steps too. Of an ensemble the curves of
        all members that succeeded are drawn.
    show
        A sequence of Euler angles, as for SciPy's ``Rotation.as_euler``: ``"ZYX"`` (default; yaw,
        pitch and roll), upper case for rotations about axes of the body, lower case for axes in
        space. Or ``"vector"``, the rotation vector; ``"rate"``, the mean angular velocity in axes
        of the body between two times; ``"error"``, the angle to `reference`.
    t
        Shape ``(n,)``. Increasing times; by default those of the solution, else 0, 1, …
    reference
        The exact attitude at the same times, as `y`; a solution with dense output is evaluated at
        these times. Or a constant attitude: one rotation, matrix or quaternion.
    wrap
        Draw Euler angles in [-180, 180] degrees. By default they are continuous, so that they grow
        beyond 360 degrees in a tumble.

    Returns
    -------
    matplotlib.axes.Axes
        Angles are in degrees, angular velocities in degrees for each unit of time.

    Warns
    -----
    UserWarning
        If the attitude turns by more than 90 degrees between two times, so that the curves between
        them mean nothing.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> run = cg.solve_ivp(
    ...     lambda t, y: [0.4, 0.2 * y[3], 1.0], (0, 3), [0.0, 0.0, 0.0, 1.0],
    ...     frame=cg.frames.UnitQuaternion(), dense_output=True,
    ... )
    >>> ax = cg.plot.attitude(run, show="vector")
    >>> ax.get_ylabel()
    'rotation vector (°)'
    """
    if not isinstance(show, str) or (
        show not in ("vector", "rate", "error")
        and (show.lower() not in _SEQUENCES or not (show.islower() or show.isupper()))
    ):
        raise ValueError(
            "show must be a sequence of Euler angles such as 'ZYX', 'vector', 'rate' or 'error', "
            f"got {show!r}"
        )
    if (show == "error") != (reference is not None):
        raise ValueError(
            "reference must be given with show='error', and only then, got "
            f"reference={reference!r} and show={show!r}"
        )
    reference = _at_times(reference)
    constant = isinstance(reference, Sized) and len(reference) == 1
    # another solution is compared at the steps, not between them
    between = t is None and (reference is None or constant)
    members = members_of(y, "y")
    wrap = check_flag("wrap", wrap)
    ax = axes_for(ax)
    for k, member in enumerate(members):
        rotations, times_of_solution = drawn_rotations(member) if between else rotations_of(member)
        times = _times(t, times_of_solution, len(rotations))
        times, curves, labels, title = _curves(show, rotations, times, reference, wrap)
        for curve, label, colour, dashes in zip(
            np.rad2deg(curves.T), labels, COLOURS, _DASHES, strict=False
        ):
            (line,) = ax.plot(times, curve, color=colour, linestyle=dashes, linewidth=1.4)
            line.set(alpha=opacity_of(members), label="_" if k else label)
    if show == "error":
        ax.set_yscale("log", nonpositive="mask")
    else:
        for handle in ax.legend(frameon=False, fontsize=8).get_lines():
            handle.set_alpha(1.0)
    unit = "° / unit of time" if show == "rate" else "°"
    ax.set(xlabel="t", ylabel=f"{title} ({unit})")
    return ax


def _at_times(reference: Any) -> Any:
    """Return a single rotation as an array of one."""
    if is_rotation(reference):
        return type(reference).concatenate([reference]) if reference.single else reference
    if reference is None or hasattr(reference, "frame"):
        return reference
    points = real_array(reference, "reference")
    return points[None] if points.shape in ((4,), (3, 3)) else points


def _curves(
    show: str, rotations: Any, times: NDArray[np.float64], reference: Any, wrap: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str], str]:
    """Return times, curves in radians, shape ``(n, curves)``, their labels and what they are."""
    labels = [f"{axis} axis" for axis in "xyz"]
    if show == "error":
        exact, _ = rotations_of(reference, "reference", times)
        if len(exact) not in (1, len(rotations)):
            raise ValueError(
                f"reference must hold {len(rotations)} rotations, as y, got {len(exact)}"
            )
        angles = np.asarray((exact.inv() * rotations).magnitude())
        return times, angles[:, None], [""], "error"
    if show == "rate":
        step = np.diff(times)
        rates = (rotations[:-1].inv() * rotations[1:]).as_rotvec() / step[:, None]
        return times[:-1] + step / 2, rates, labels, "angular velocity"
    if show == "vector":
        return times, rotations.as_rotvec(), labels, "rotation vector"
    sequence: Any = show
    names = _AIRCRAFT if show == "ZYX" else [f"{order} angle" for order in _ORDER]
    labels = [f"{name}, {axis}" for name, axis in zip(names, show, strict=True)]
    angles = rotations.as_euler(sequence)
    if wrap:
        jumps = np.abs(np.diff(angles, axis=0)) > np.pi
        angles[1:][jumps] = np.nan  # no line from one end of the range to the other
    else:
        angles = np.unwrap(angles, axis=0)
    return times, angles, labels, "Euler angles"


def _times(t: Any, times: NDArray[np.float64] | None, count: int) -> NDArray[np.float64]:
    """Return the times of the rotations: `t`, else those of the solution, else indices."""
    if t is None:
        return np.arange(count, dtype=np.float64) if times is None else times
    times = real_array(t, "t")
    check_finite(times, "t")
    if times.shape != (count,):
        raise ValueError(f"t must have shape ({count},), as many times as y, got {times.shape}")
    if not (np.diff(times) > 0.0).all():
        raise ValueError(f"t must increase, got {times}")
    return times
