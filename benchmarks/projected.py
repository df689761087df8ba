"""SciPy's DOP853 on the entries of a point, with projection onto the manifold after each step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from cg.frames import SO3, Product, Sphere

__all__ = ["integrate", "project"]

Array = NDArray[np.float64]


def project(frame: Product, y: Array) -> Array:
    """Return the nearest point of a product of ``SO3``, ``Sphere`` and Euclidean spaces."""
    parts = []
    for factor, part in zip(frame.factors, frame.split(y), strict=True):
        nearest = part
        if isinstance(factor, SO3):
            left, _, right = np.linalg.svd(part)
            nearest = left @ right
        elif isinstance(factor, Sphere):
            nearest = part / np.linalg.norm(part)
        parts.append(nearest)
    return frame.join(*parts)


def integrate(
    f: Callable[[float, Array], Array],
    end: float,
    y0: Array,
    frame: Product,
    tolerance: float,
    *,
    projected: bool,
) -> Array:
    """Return all points from time 0 on, shape ``(steps + 1, n)``.

    Parameters
    ----------
    f : callable
        The coefficients, of which the frame makes the derivatives of the entries.
    end : float
    y0 : ndarray, shape (n,)
    frame : Product
    tolerance : float
        ``rtol`` and ``atol``.
    projected : bool
        Whether points are projected.
    """

    def derivatives(t: float, y: Array) -> Array:
        # by hand, since the general fields of a frame take several times as long
        rates = np.asarray(f(t, y), dtype=np.float64)
        found = np.empty_like(y)
        begin, first = 0, 0
        for factor in frame.factors:
            v = rates[begin : begin + factor.dim]
            size = int(np.prod(factor.point_shape))
            part = slice(first, first + size)
            if isinstance(factor, SO3):
                x, z, w = v.tolist()
                found[part] = (y[part].reshape(3, 3) @ [[0, -w, z], [w, 0, -x], [-z, x, 0]]).ravel()
            elif isinstance(factor, Sphere):
                (a, b, c), (x, z, w) = v.tolist(), y[part].tolist()
                found[part] = b * w - c * z, c * x - a * w, a * z - b * x
            else:
                found[part] = v
            begin, first = begin + factor.dim, first + size
        return found

    solver = DOP853(derivatives, 0.0, y0, end, rtol=tolerance, atol=tolerance)
    points = [y0]
    while solver.status == "running":
        solver.step()
        if projected:
            solver.y = project(frame, solver.y)
            solver.f = derivatives(solver.t, solver.y)
        points.append(solver.y)
    if solver.status == "failed":
        raise RuntimeError("DOP853 failed")
    return np.array(points)
