"""The Runge-Kutta-Munthe-Kaas method of order four, to compare with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cg.frames import SO3, Euclidean, Frame, Product, Sphere
from cg.integration.flows import flows_of

__all__ = ["RKMK4"]

Array = NDArray[np.float64]


class RKMK4:
    r"""The classical method of order four for :math:`u` in :math:`y = e^{u} y_0`.

    The equation for :math:`u` is :math:`u' = f \mp \tfrac12 [u, f] + \tfrac1{12} [u, [u, f]] +
    \dots`, of which the terms shown suffice for order four [1]_.  The sign is that of the side
    from which the flows act.

    Parameters
    ----------
    f : callable
        ``f(t, y)`` returns coefficients, shape ``(dim,)``.
    frame : Frame
        A product of ``SO3()``, ``Sphere(2)`` and Euclidean spaces.

    Attributes
    ----------
    nexp : int
        Flows so far.

    References
    ----------
    .. [1] H. Munthe-Kaas, "High order Runge-Kutta methods on manifolds", Appl. Numer. Math. 29
       (1999), 115-127.
    """

    def __init__(self, f: Callable[[float, Array], Array], frame: Frame) -> None:
        self.f = f
        self.dim = frame.dim
        self.flows = flows_of(frame)
        self.nexp = 0
        self.blocks: list[tuple[int, float]] = []
        begin = 0
        for factor in frame.factors if isinstance(frame, Product) else (frame,):
            match factor:
                case SO3(convention="body"):
                    self.blocks.append((begin, 0.5))
                case Sphere(n=2):
                    self.blocks.append((begin, -0.5))
                case Euclidean():
                    pass
                case _:
                    raise ValueError(f"frame must not contain {factor!r}")
            begin += factor.dim

    def integrate(self, t_span: tuple[float, float], y0: Array, steps: int) -> Array:
        """Return all points, shape ``(steps + 1, *point_shape)``."""
        h = (t_span[1] - t_span[0]) / steps
        points = np.empty((steps + 1, *np.shape(y0)))
        points[0] = y = np.array(y0)
        for k in range(steps):
            points[k + 1] = y = self._step(t_span[0] + k * h, y, h)
        return points

    def _step(self, t: float, y: Array, h: float) -> Array:
        k1 = self._field(t, y)
        u2 = 0.5 * h * k1
        k2 = self._transport(u2, self._field(t + 0.5 * h, self._move(u2, y)))
        u3 = 0.5 * h * k2
        k3 = self._transport(u3, self._field(t + 0.5 * h, self._move(u3, y)))
        u4 = h * k3
        k4 = self._transport(u4, self._field(t + h, self._move(u4, y)))
        return self._move(h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), y)

    def _field(self, t: float, y: Array) -> Array:
        return np.asarray(self.f(t, y), dtype=np.float64)

    def _move(self, u: Array, y: Array) -> Array:
        self.nexp += 1
        return self.flows(u[None], y)

    def _transport(self, u: Array, f: Array) -> Array:
        """Return the derivative of u that goes with the coefficients f."""
        found = f.copy()
        for begin, half in self.blocks:
            part = slice(begin, begin + 3)
            a, b = u[part].tolist(), f[part].tolist()
            once = _cross(a, b)
            twice = _cross(a, once)
            found[part] += [half * x + z / 12.0 for x, z in zip(once, twice, strict=True)]
        return found


def _cross(a: list[float], b: list[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
