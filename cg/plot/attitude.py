"""Plots of an attitude over time, and the rotations that plots are given."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from cg.frames.base import Frame
from cg.frames.product import Product
from cg.frames.quaternion import UnitQuaternion
from cg.frames.rotations import SE3, SO, is_rotation
from cg.plot.style import COLOURS, DASHES, axes_for, drawn, members_of, opacity_of
from cg.support.arrays import Array, real_array
from cg.support.checks import short, warn_user

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


_MEMBERSHIP_ERROR = 1e-6  # largest one of arrays that are drawn


def drawn_rotations(y: Any) -> tuple[Rotation, Array | None]:
    """Return the rotations that are drawn of a solution or an array, and the times of a solution.

    ValueError if there are none; a warning if two are more than 90° apart.
    """
    frame, times, points = drawn(y)
    rotations = points if is_rotation(points) else rotations_on(frame, points)
    if rotations is None or rotations.single or len(rotations) == 0:
        raise ValueError(f"y must hold rotations at one or more times, got {short(y)}")
    turns = (rotations[:-1].inv() * rotations[1:]).magnitude() if len(rotations) > 1 else [0.0]
    if (largest := np.rad2deg(np.max(turns))) > 90.0:
        warn_user(
            f"the attitude turns by {largest:.0f} degrees between two times, so that the "
            "curves between them mean nothing: integrate with dense_output=True, or give more "
            "points"
        )
    return rotations, times


def rotations_on(frame: Frame | None, points: Any) -> Rotation | None:
    """Return the rotations of points of a frame, or without one of matrices or quaternions.

    A product has the rotations of its first factor with any. None if the frame has no rotations.
    """
    if frame is None:
        points = real_array(points, "y")
        if not points.size or points.shape[1:] not in ((3, 3), (4,)):
            raise ValueError(
                "y must be a Solution, a Rotation, matrices of shape (n, 3, 3) or quaternions of "
                f"shape (n, 4), got shape {points.shape}"
            )
        frame = SO(3) if points.ndim == 3 else UnitQuaternion()
        if not (distance := frame.membership_error(points).max()) <= _MEMBERSHIP_ERROR:
            raise ValueError(
                f"y must hold points of {frame!r}; the farthest is {distance:.3g} away"
            )
    if isinstance(frame, UnitQuaternion) or (isinstance(frame, SO) and frame.n == 3):
        return frame.as_rotation(points)
    if isinstance(frame, SE3):
        return SO(3).as_rotation(points[..., :3, :3])
    if isinstance(frame, Product):
        rotations = map(rotations_on, frame.factors, frame.split(points))
        return next((rotation for rotation in rotations if rotation is not None), None)
    return None


_SEQUENCES = {
    "".join(axes)
    for letters in ("xyz", "XYZ")
    for axes in product(letters, repeat=3)
    if axes[0] != axes[1] != axes[2]
}


def attitude(y: Any, ax: Any = None, *, show: str = "ZYX", t: Any = None) -> Any:
    """Draw Euler angles or the rotation vector of an attitude against time.

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
        space; they are continuous, so that they grow beyond 360 degrees in a tumble. Or
        ``"vector"``, the rotation vector.
    t
        Shape ``(n,)``. Increasing times; by default those of the solution, else 0, 1, …

    Returns
    -------
    matplotlib.axes.Axes
        Angles are in degrees.

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
    if show not in ("vector", *_SEQUENCES):
        raise ValueError(
            f"show must be a sequence of Euler angles such as 'ZYX', or 'vector', got {show!r}"
        )
    members = members_of(y, "y")
    ax = axes_for(ax)
    for k, member in enumerate(members):
        rotations, times = drawn_rotations(member)
        if t is not None:
            times = real_array(t, "t")
            if times.shape != (len(rotations),) or not (np.diff(times) > 0.0).all():
                raise ValueError(f"t must be {len(rotations)} increasing times, as y has, got {t}")
        elif times is None:
            times = np.arange(len(rotations), dtype=np.float64)
        curves, labels, title = _angle_curves(show, rotations)
        for curve, label, colour, dashes in zip(
            np.rad2deg(curves.T), labels, COLOURS, DASHES, strict=False
        ):
            (line,) = ax.plot(times, curve, color=colour, linestyle=dashes, linewidth=1.4)
            line.set(alpha=opacity_of(members), label="_" if k else label)
    for handle in ax.legend(frameon=False, fontsize=8).get_lines():
        handle.set_alpha(1.0)
    ax.set(xlabel="t", ylabel=f"{title} (°)")
    return ax


def _angle_curves(show: str, rotations: Rotation) -> tuple[Array, list[str], str]:
    """Return curves in radians, shape ``(n, 3)``, their labels and what they are."""
    if show == "vector":
        return rotations.as_rotvec(), [f"{axis} axis" for axis in "xyz"], "rotation vector"
    sequence: Any = show
    aircraft = show == "ZYX"
    names = ("yaw", "pitch", "roll") if aircraft else ("first angle", "second angle", "third angle")
    labels = [f"{name}, {axis}" for name, axis in zip(names, show, strict=True)]
    return np.unwrap(rotations.as_euler(sequence), axis=0), labels, "Euler angles"
