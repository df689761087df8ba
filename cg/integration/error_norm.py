"""The norm in which error estimates are compared with the tolerances."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.flows import difference_of

__all__ = ["ErrorNorm"]


class ErrorNorm:
    r"""The norm in which error estimates are compared with the tolerances.

    The difference between two results is :math:`e` with :math:`e^{e} \hat y = y`, the
    coefficients of the flow from one to the other, where the frame has such coordinates, and
    :math:`y - \hat y` where it hasn't.  The norm is the root mean square of
    :math:`e_i / (\mathrm{atol}_i + \mathrm{rtol}\, s_i)`.  The sizes :math:`s_i` are those of
    `Frame.coordinate_sizes`: on Euclidean space :math:`|y_i|`, so that the
    norm is that of SciPy there, and 1 for coordinates that have no magnitude of their own, so
    that ``rtol`` is an angle in radians for rotations.  In the ambient space :math:`s` is the
    root mean square of the entries of the point.  Of an ensemble it is the largest of its
    members' norms.

    Parameters
    ----------
    frame
        The frame.
    point
        Any point, or an ensemble of them.
    rtol, atol
        The tolerances; ``atol`` has shape ``(frame.dim,)`` or ``()``, where the frame has no
        logarithm ``point_shape`` or ``()``.

    Raises
    ------
    ValueError
        If ``atol`` has another shape.
    """

    def __init__(self, frame: Frame, point: Points, rtol: float, atol: Array) -> None:
        self.frame = frame
        self.rtol = rtol
        self.atol = atol
        self.in_algebra = frame.exp_coordinates(point, point) is not None
        shape = (frame.dim,) if self.in_algebra else frame.point_shape
        if atol.shape not in ((), shape):
            raise ValueError(f"atol must be a number or have shape {shape}, got {atol.shape}")
        self.axes = tuple(range(-len(shape), 0))
        self.coordinates = difference_of(frame)

    def size(self, y: Points) -> Array:
        """Return what relative errors at a point are relative to, with the axes of `scale`."""
        if self.in_algebra:
            return self.frame.coordinate_sizes(y)
        return _rms(y, self.axes, keepdims=True)

    def scale(self, *points: Points) -> Array:
        """Return the tolerances at the largest of some points, all positive."""
        largest = np.max([self.size(y) for y in points], axis=0)
        return np.asarray(np.maximum(self.atol + self.rtol * largest, np.finfo(np.float64).tiny))

    def tangent(self, v: Array, y: Points) -> Points:
        """Return a field's value in the space where errors are measured."""
        return v if self.in_algebra else self.frame.field(v, y)

    def difference(self, y0: Points, y1: Points) -> Points:
        """Return the difference of two points in the space where errors are measured."""
        difference = self.coordinates(y0, y1)
        return y1 - y0 if difference is None else difference

    def error(self, y: Points, other: Points, before: Points) -> float:
        """Return the norm of the difference of two results of a step; at most 1 is accepted."""
        return float(np.max(self.rms(self.difference(other, y) / self.scale(before, y))))

    def estimate(self, fields: Array, y: Points, before: Points) -> float:
        """Return the norm of differences of results that are given by their coefficients.

        Parameters
        ----------
        fields
            Of one estimate or of two, which make one as in DOP853, shape ``(1 or 2, *batch, dim)``.
        y, before
            The points after and before the step, shape ``(*batch, *point_shape)``.
        """
        scale = self.scale(before, y)
        tangents = [self.tangent(self.frame.shortest(v, y), y) for v in fields]
        errors = [self.rms(tangent / scale) for tangent in tangents]
        if len(errors) == 1:
            return float(np.max(errors[0]))
        size = np.hypot(errors[0], 0.1 * errors[1])
        ratio = np.divide(errors[0], size, out=np.zeros_like(size), where=size != 0.0)
        return float(np.max(errors[0] * ratio))

    def rms(self, values: Array) -> Array:
        """Return the root mean square of each member's values, shape ``batch``."""
        return _rms(values, self.axes)


def _rms(values: ArrayLike, axes: tuple[int, ...], *, keepdims: bool = False) -> Array:
    """Return the root mean square of absolute values over axes."""
    squares = np.abs(values) ** 2
    return np.asarray(np.sqrt(np.mean(squares, axis=axes, keepdims=keepdims)))
