r"""Continuous solutions that stay on the manifold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Array, Points
from cg.integrate.step import Step


class Segment:
    r"""The solution within one step, of local order four, on the manifold to rounding.

    It is determined by the points and coefficients at the two ends, like the cubic of Hermite,
    which it is on a flat manifold.  From the left end it departs along the flow of the
    coefficients there, bent so as to end at the right point, and the other way round,

    .. math::

        L(\theta) &= e^{\theta^2 \delta_L} e^{\theta h F_0} y_0, &
        e^{\delta_L} e^{h F_0} y_0 &= y_1, \\
        R(\theta) &= e^{(1 - \theta)^2 \delta_R} e^{-(1 - \theta) h F_1} y_1, &
        e^{\delta_R} e^{-h F_1} y_1 &= y_0 .

    The errors of these two are :math:`c h^3 \theta^2 (1 - \theta)` and
    :math:`-c h^3 \theta (1 - \theta)^2` up to :math:`O(h^4)`, since reversing time changes the
    sign of the term of third order.  They cancel in

    .. math:: y(\theta) = e^{\theta v} L(\theta), \qquad e^v L(\theta) = R(\theta) .

    Values and derivatives at both ends are exact, hence the whole solution is continuously
    differentiable.  All logarithms are those of nearly equal points, however far apart the ends
    of the step are.  Where the frame has no logarithm, the method itself takes a step of
    :math:`\theta h`, which evaluates ``f`` but stays on the manifold and keeps its order.

    Parameters
    ----------
    step
        The step function that led from one end to the other.
    t0, y0, t1, y1
        The ends; points of shape ``(*batch, *point_shape)``.
    """

    def __init__(self, step: Step, t0: float, y0: Points, t1: float, y1: Points) -> None:
        self.t0, self.y0 = t0, y0
        self.t1, self.y1 = t1, y1
        self._step = step
        frame, h = step.frame, t1 - t0
        self._bends: tuple[Array, Array, Array, Array] | None = None
        forth = h * step.field(t0, y0)
        bend_forth = frame.exp_coordinates(frame.flow(forth, y0), y1)
        step.nexp += 1
        if bend_forth is None or not np.isfinite(bend_forth).all():
            return
        back = -h * step.field(t1, y1)
        bend_back = frame.exp_coordinates(frame.flow(back, y1), y0)
        step.nexp += 1
        if bend_back is not None and np.isfinite(bend_back).all():
            self._bends = forth, bend_forth, back, bend_back

    def __call__(self, t: Array) -> Points:
        """Return the points at times within the step.

        Parameters
        ----------
        t
            Shape ``(n,)``.

        Returns
        -------
        ndarray
            Shape ``(n, *batch, *point_shape)``.
        """
        theta = (t - self.t0) / (self.t1 - self.t0)
        points = self._blend(theta)
        points[t == self.t0] = self.y0
        points[t == self.t1] = self.y1
        return points

    def _blend(self, theta: Array) -> Points:
        if self._bends is None:
            return self._steps(theta)
        frame = self._step.frame
        forth, bend_forth, back, bend_back = self._bends
        s = theta.reshape(-1, *[1] * forth.ndim)
        left = frame.flow(s**2 * bend_forth, frame.flow(s * forth, self.y0))
        right = frame.flow((1.0 - s) ** 2 * bend_back, frame.flow((1.0 - s) * back, self.y1))
        self._step.nexp += 5 * len(theta)
        v = frame.exp_coordinates(left, right)
        assert v is not None
        points = frame.flow(s * v, left)
        missing = ~np.isfinite(v).all(axis=tuple(range(1, v.ndim)))
        if missing.any():
            points[missing] = self._steps(theta[missing])
        return points

    def _steps(self, theta: Array) -> Points:
        h = self.t1 - self.t0
        points = [self._step(self.t0, self.y0, x * h) if x else self.y0 for x in theta.tolist()]
        return np.array(points).reshape(-1, *self.y0.shape)


class DenseOutput:
    """A solution as a function of time, on the manifold at all times.

    Parameters
    ----------
    ts
        Times, strictly monotonic, shape ``(steps + 1,)``.
    segments
        The solution between them.
    y0
        The initial point, which is the whole solution if there are no segments.

    Attributes
    ----------
    ts
        The times of the steps, shape ``(steps + 1,)``.
    t_min, t_max
        Between which times there is a solution.
    """

    def __init__(self, ts: ArrayLike, segments: Sequence[Segment], y0: Points) -> None:
        self.ts = np.array(ts, dtype=np.float64)
        self.ts.flags.writeable = False
        self.t_min = float(self.ts.min())
        self.t_max = float(self.ts.max())
        self._segments = tuple(segments)
        self._y0 = y0
        self._sign = -1.0 if self.ts[-1] < self.ts[0] else 1.0

    def __repr__(self) -> str:
        return f"DenseOutput(t={self.ts[0]:g}...{self.ts[-1]:g}, steps={len(self._segments)})"

    def __call__(self, t: ArrayLike) -> Points:
        """Return the solution.

        Parameters
        ----------
        t
            Times, of any shape, between ``t_min`` and ``t_max``.

        Returns
        -------
        ndarray
            Shape ``(*t.shape, *batch, *point_shape)``: time comes first.

        Raises
        ------
        ValueError
            If a time is beyond the ends.
        """
        times = np.asarray(t, dtype=np.float64)
        if not ((times >= self.t_min) & (times <= self.t_max)).all():
            raise ValueError(f"t must lie between {self.t_min:g} and {self.t_max:g}, got {t!r}")
        flat = times.ravel()
        points = np.empty((flat.size, *self._y0.shape), dtype=self._y0.dtype)
        points[:] = self._y0
        if self._segments:
            which = np.searchsorted(self._sign * self.ts, self._sign * flat, side="left") - 1
            which = np.maximum(which, 0)
            for k in np.unique(which).tolist():
                points[which == k] = self._segments[k](flat[which == k])
        return points.reshape(*times.shape, *self._y0.shape)
