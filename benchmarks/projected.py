"""SciPy's DOP853 on the entries of a point, with projection onto the manifold after each step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from cg.frames import SO3, Euclidean, Frame, MatrixGroup, Power, Product, Sphere, UnitQuaternion

Points = NDArray[Any]
Tangent = Callable[[Any, Any], Points]
Field = Callable[[float, Points], Sequence[float] | NDArray[np.float64]]


def project(frame: Frame, y: Points) -> Points:
    """Return the nearest point, by hand where that is faster than `Frame.project`."""
    if isinstance(frame, Product):
        parts = zip(frame.factors, frame.split(y), strict=True)
        return frame.join(*(project(factor, part) for factor, part in parts))
    if isinstance(frame, SO3):
        left, _, right = np.linalg.svd(y)
        return np.asarray(left @ right)
    if isinstance(frame, Sphere | UnitQuaternion):
        return np.asarray(y / np.sqrt(y @ y))
    return y if isinstance(frame, Euclidean) else frame.project(y)


def integrate(
    f: Field, end: float, y0: Points, frame: Frame, tolerance: float, *, projected: bool
) -> tuple[Points, int]:
    """Return all points from time 0 on, shape ``(steps + 1, *y0.shape)``, and the evaluations.

    The derivative at the end of a step is that before projection, so that a step takes no
    evaluation more than it has.

    Parameters
    ----------
    f : callable
        The coefficients, of which the frame makes the derivatives of the entries.
    end : float
    y0 : ndarray
    frame : Frame
    tolerance : float
        ``rtol`` and ``atol``.
    projected : bool
        Whether points are projected.
    """
    tangent = _tangent(frame)

    def derivative(t: float, y: Points) -> Points:
        return tangent(np.asarray(f(t, y), dtype=np.float64), y)

    nearest = partial(project, frame) if projected else None
    return integrate_entries(derivative, end, y0, nearest, tolerance)


def integrate_entries(
    f: Tangent, end: float, y0: Points, nearest: Callable[[Points], Points] | None, tolerance: float
) -> tuple[Points, int]:
    """Return the same for a function that returns derivatives, and one that projects."""
    shape = y0.shape

    def derivatives(t: float, y: Points) -> Points:
        return f(t, y.reshape(shape)).ravel()

    solver = DOP853(derivatives, 0.0, y0.ravel(), end, rtol=tolerance, atol=tolerance)
    points = [y0]
    while solver.status == "running":
        solver.step()
        if nearest is not None:
            solver.y = nearest(solver.y.reshape(shape)).ravel()
        points.append(solver.y.reshape(shape))
    if solver.status == "failed":
        raise RuntimeError("DOP853 failed")
    return np.array(points), solver.nfev


def _tangent(frame: Frame) -> Tangent:
    """Return what makes derivatives of coefficients, by hand: frames check their arguments."""
    tangent: Tangent = frame.field
    match frame:
        case Product():
            tangent = _tangent_of_product(frame)
        case SO3(convention="body"):
            tangent = _turned
        case Sphere(n=2):
            tangent = _moved
        case UnitQuaternion(convention="body", scalar_first=False):
            tangent = _half_product
        case Euclidean():
            tangent = _same
        case MatrixGroup(convention="space"):
            tangent = _tangent_of_group(frame, ())
        case Power(factor=MatrixGroup(convention="space") as group, n=n):
            tangent = _tangent_of_group(group, (n,))
    return tangent


def _tangent_of_group(group: MatrixGroup, lead: tuple[int, ...]) -> Tangent:
    size, basis = group.size, group.basis.reshape(group.dim, -1)

    def tangent(v: NDArray[np.float64], y: Points) -> Points:
        matrices = v.reshape(*lead, -1) @ basis
        return np.asarray(matrices.reshape(*lead, size, size) @ y)

    return tangent


def _tangent_of_product(frame: Product) -> Tangent:
    parts = []
    begin = first = 0
    for factor in frame.factors:
        size = int(np.prod(factor.point_shape))
        coefficients, entries = slice(begin, begin + factor.dim), slice(first, first + size)
        parts.append((_tangent(factor), coefficients, entries, factor.point_shape))
        begin, first = begin + factor.dim, first + size

    def tangent(v: NDArray[np.float64], y: Points) -> Points:
        derivative = np.empty_like(y)
        for one, coefficients, entries, shape in parts:
            derivative[entries] = one(v[coefficients], y[entries].reshape(shape)).ravel()
        return derivative

    return tangent


def _same(v: NDArray[np.float64], y: Points) -> Points:
    return v


def _turned(v: NDArray[np.float64], y: Points) -> Points:
    a, b, c = v.tolist()
    return np.asarray(y @ [[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])


def _moved(v: NDArray[np.float64], y: Points) -> Points:
    (a, b, c), (x, z, w) = v.tolist(), y.tolist()
    return np.array([b * w - c * z, c * x - a * w, a * z - b * x])


def _half_product(v: NDArray[np.float64], y: Points) -> Points:
    (a, b, c), (x, z, w, s) = (0.5 * v).tolist(), y.tolist()
    last = -x * a - z * b - w * c
    return np.array([s * a + z * c - w * b, s * b + w * a - x * c, s * c + x * b - z * a, last])
