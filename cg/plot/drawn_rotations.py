"""Rotations of solutions and arrays, for plots."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.product import Product
from cg.frames.quaternion import UnitQuaternion
from cg.frames.rotations import is_rotation
from cg.frames.se3 import SE3
from cg.frames.so import SO
from cg.plot.style import check_stored
from cg.support.arrays import check_finite, real_array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_TOLERANCE = 1e-6
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
        if points.size and (distance := frame.membership_error(points).max()) > _TOLERANCE:
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
        parts = map(rotations_on, frame.factors, frame.split(y))
        return next((part for part in parts if part is not None), None)
    return None
