"""Plots of an attitude over time, and the rotations that plots are given."""

from __future__ import annotations

import warnings
from collections.abc import Sized
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.product import Product
from cg.frames.quaternion import UnitQuaternion
from cg.frames.rotations import SE3, SO, is_rotation
from cg.plot.style import COLOURS, axes_for, check_stored, members_of, opacity_of
from cg.support.arrays import check_finite, real_array
from cg.support.checks import check_flag

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


_MEMBERSHIP_ERROR = 1e-6  # largest one of arrays that are drawn
POINTS = 1000  # drawn of a solution with dense output


def drawn_rotations(y: Any) -> tuple[Rotation, NDArray[np.float64] | None]:
    """Return `rotations_of` a solution, dense if it can be; warn if two are more than 90° apart."""
    dense = getattr(y, "sol", None) is not None
    rotations, times = rotations_of(y, at=np.linspace(y.t[0], y.t[-1], POINTS) if dense else None)
    turns = (rotations[:-1].inv() * rotations[1:]).magnitude() if len(rotations) > 1 else [0.0]
    if (largest := np.rad2deg(np.max(turns))) > 90.0:
        warnings.warn(
            f"the attitude turns by {largest:.0f} degrees between two times, so that the "
            "curves between them mean nothing: integrate with dense_output=True, or give more "
            "points",
            stacklevel=3,
        )
    return rotations, times


def rotations_of(
    y: Any, name: str = "y", at: NDArray[np.float64] | None = None
) -> tuple[Rotation, NDArray[np.float64] | None]:
    """Return the rotations of a solution or an array, see `cg.plot.attitude`, and its times.

    Of a product the first factor with rotations is taken. A solution with dense output is evaluated
    at the times `at`. ValueError, with the `name` of the argument, if there are no rotations.
    """
    frame, times = getattr(y, "frame", None), None
    check_stored(y, name)
    if isinstance(frame, Frame):
        times, points = np.asarray(y.t, dtype=np.float64), np.asarray(y.y)
        if points.ndim != 1 + len(frame.point_shape):
            raise ValueError(
                f"{name} must be a solution of one point, such as run[0] of an ensemble"
            )
        if at is not None and y.sol is not None:
            times, points = at, np.asarray(y.sol(at))
        rotations = rotations_on(frame, points)
        if rotations is None:
            raise ValueError(f"{name} must be a solution with rotations, got one on {frame!r}")
    elif is_rotation(y):
        rotations = y
    else:
        points = real_array(y, name)
        if points.ndim not in (2, 3) or points.shape[1:] not in ((3, 3), (4,)):
            raise ValueError(
                f"{name} must be a Solution, a Rotation, matrices of shape (n, 3, 3) or "
                f"quaternions of shape (n, 4), got shape {points.shape}"
            )
        check_finite(points, name)
        frame = SO(3) if points.ndim == 3 else UnitQuaternion()
        if points.size and (distance := frame.membership_error(points).max()) > _MEMBERSHIP_ERROR:
            raise ValueError(
                f"{name} must hold points of {frame!r}; the farthest is {distance:.3g} away"
            )
        rotations = rotations_on(frame, points)
    if rotations is None or rotations.single or len(rotations) == 0:
        raise ValueError(f"{name} must hold rotations at one or more times, got {y!r}")
    return rotations, times


def rotations_on(frame: Frame, y: Any) -> Rotation | None:
    """Return the rotations of points of a frame, or None if it has none."""
    if isinstance(frame, UnitQuaternion) or (isinstance(frame, SO) and frame.n == 3):
        return frame.as_rotation(y)
    if isinstance(frame, SE3):
        return SO(3).as_rotation(y[..., :3, :3])
    if isinstance(frame, Product):
        rotations = map(rotations_on, frame.factors, frame.split(y))
        return next((rotation for rotation in rotations if rotation is not None), None)
    return None


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
