r"""Continuous solutions that stay on the manifold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.frames.base import Array, Frame, Points, real_array
from cg.integration.step import Step


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
        points = np.empty((len(t), *self.y0.shape), dtype=self.y0.dtype)
        points[t == self.t0] = self.y0
        points[t == self.t1] = self.y1
        between = (t != self.t0) & (t != self.t1)
        if between.any():
            points[between] = self._blend((t[between] - self.t0) / (self.t1 - self.t0))
        return points

    def _blend(self, theta: Array) -> Points:
        if self._bends is None:
            return self._steps(theta)
        s = theta.reshape(-1, *[1] * self._bends[0].ndim)
        self._step.nexp += 5 * len(theta)
        points, missing = _blend(self._step.frame, s, self.y0, self.y1, *self._bends)
        if missing.any():
            points[missing] = self._steps(theta[missing])
        return points

    def _steps(self, theta: Array) -> Points:
        h = self.t1 - self.t0
        points = [self._step(self.t0, self.y0, x * h) for x in theta.tolist()]
        return np.array(points).reshape(-1, *self.y0.shape)


class SegmentTable:
    """The solutions within all steps of one trajectory, evaluated for many times at once.

    Parameters
    ----------
    step
        The step function.
    ts
        Times at the ends of steps, shape ``(steps + 1,)``.
    ys
        Points there, shape ``(steps + 1, *point_shape)``.
    slopes
        Coefficients there, shape ``(steps + 1, dim)``.
    """

    def __init__(self, step: Step, ts: Array, ys: Points, slopes: Array) -> None:
        self.ts, self.ys = ts, ys
        self._step = step
        self._slopes = slopes

    def __len__(self) -> int:
        return len(self.ts) - 1

    def __call__(self, which: NDArray[np.intp], t: Array) -> Points:
        """Return the points at times, shape ``(n, *point_shape)``.

        Parameters
        ----------
        which
            The numbers of the steps that the times lie in, shape ``(n,)``.
        t
            Shape ``(n,)``.
        """
        frame = self._step.frame
        t0, y0 = self.ts[which], self.ys[which]
        t1, y1 = self.ts[which + 1], self.ys[which + 1]
        h, s = t1 - t0, ((t - t0) / (t1 - t0))[:, None]
        forth = h[:, None] * self._slopes[which]
        back = -h[:, None] * self._slopes[which + 1]
        bend_forth = frame.exp_coordinates(frame.flow(forth, y0), y1)
        bend_back = frame.exp_coordinates(frame.flow(back, y1), y0)
        assert bend_forth is not None
        assert bend_back is not None
        points, missing = _blend(frame, s, y0, y1, forth, bend_forth, back, bend_back)
        self._step.nexp += 7 * len(t)
        for i in np.flatnonzero(missing & (t != t0)).tolist():
            points[i] = self._step(float(t0[i]), y0[i], float(t[i] - t0[i]))
        points[t == t0] = y0[t == t0]
        points[t == t1] = y1[t == t1]
        return points


class StoredSegment:
    """The solution within one step whose coefficients at the ends are stored.

    Parameters
    ----------
    step
        The step function.
    ts
        Times at the ends, shape ``(2,)``.
    ys
        Points there, shape ``(2, *point_shape)``.
    slopes
        Coefficients there, each of shape ``(dim,)``; the last may be None if it isn't known, and
        is found when it is needed.

    Attributes
    ----------
    last
        The last coefficients, if they are known by now.
    """

    def __init__(
        self, step: Step, ts: Array, ys: Points, slopes: tuple[Array, Array | None]
    ) -> None:
        self.t0, self.t1 = ts.tolist()
        self.y0, self.y1 = ys
        self.last = slopes[1]
        self._known = step, ts, ys, slopes[0]
        self._table: SegmentTable | None = None

    def __call__(self, t: Array) -> Points:
        """Return the points at times within the step, shape ``(n, *point_shape)``."""
        if self._table is None:
            step, ts, ys, first = self._known
            if self.last is None:
                self.last = step.evaluate(self.t1, self.y1)
            self._table = SegmentTable(step, ts, ys, np.stack([first, self.last]))
        return self._table(np.zeros(len(t), dtype=np.intp), t)


def _blend(
    frame: Frame,
    s: Array,
    y0: Points,
    y1: Points,
    forth: Array,
    bend_forth: Array,
    back: Array,
    bend_back: Array,
) -> tuple[Points, NDArray[np.bool_]]:
    """Return the points at fractions ``s`` of steps, and at which of them there is none."""
    left = frame.flow(s**2 * bend_forth, frame.flow(s * forth, y0))
    right = frame.flow((1.0 - s) ** 2 * bend_back, frame.flow((1.0 - s) * back, y1))
    v = frame.exp_coordinates(left, right)
    assert v is not None
    missing = np.asarray(~np.isfinite(v).all(axis=tuple(range(1, v.ndim))))
    return frame.flow(s * v, left), missing


class DenseOutput:
    """A solution as a function of time, on the manifold at all times.

    Parameters
    ----------
    ts
        Times, strictly monotonic, shape ``(steps + 1,)``.
    segments
        The solution between them, one for each step.
    y0
        The initial point, which is the whole solution if there are no segments.

    Attributes
    ----------
    ts
        The times of the steps, shape ``(steps + 1,)``.
    t_min, t_max
        Between which times there is a solution.
    """

    def __init__(
        self, ts: ArrayLike, segments: Sequence[Segment] | SegmentTable, y0: Points
    ) -> None:
        self.ts = np.array(ts, dtype=np.float64)
        self.ts.flags.writeable = False
        self.t_min = float(self.ts.min())
        self.t_max = float(self.ts.max())
        self._segments = segments if isinstance(segments, SegmentTable) else tuple(segments)
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
            If a time is beyond the ends, or ``t`` isn't real numbers.
        """
        times = real_array(t, "t")
        if not ((times >= self.t_min) & (times <= self.t_max)).all():
            raise ValueError(f"t must lie between {self.t_min:g} and {self.t_max:g}, got {t!r}")
        return self._evaluate(times.ravel()).reshape(*times.shape, *self._y0.shape)

    def _evaluate(self, flat: Array) -> Points:
        points = np.empty((flat.size, *self._y0.shape), dtype=self._y0.dtype)
        points[:] = self._y0
        if not self._segments:
            return points
        which = np.searchsorted(self._sign * self.ts, self._sign * flat, side="left") - 1
        which = np.maximum(which, 0)
        if isinstance(self._segments, SegmentTable):
            return self._segments(which, flat)
        for k in np.unique(which).tolist():
            points[which == k] = self._segments[k](flat[which == k])
        return points


class EnsembleOutput(DenseOutput):
    """The solutions of an ensemble whose members have their own steps, as a function of time.

    It is NaN for a member beyond the time that the member's integration ended at.

    Parameters
    ----------
    members
        The members' solutions.
    y0
        The initial points, shape ``(*batch, *point_shape)``.
    batch
        The leading axes.

    Attributes
    ----------
    ts
        The times of all members' steps.
    """

    def __init__(self, members: Sequence[DenseOutput], y0: Points, batch: tuple[int, ...]) -> None:
        forward = max((m.ts[-1] - m.ts[0] for m in members), key=abs) >= 0.0
        ts = np.unique(np.concatenate([member.ts for member in members]))
        super().__init__(ts if forward else ts[::-1], (), y0)
        self._members = tuple(members)
        self._batch = batch

    def __repr__(self) -> str:
        return f"EnsembleOutput(t={self.ts[0]:g}...{self.ts[-1]:g}, members={len(self._members)})"

    def _evaluate(self, flat: Array) -> Points:
        points = np.full((flat.size, *self._y0.shape), np.nan, dtype=self._y0.dtype)
        rows = points.reshape(flat.size, len(self._members), *self._y0.shape[len(self._batch) :])
        for i, member in enumerate(self._members):
            inside = (flat >= member.t_min) & (flat <= member.t_max)
            rows[inside, i] = member(flat[inside])
        return points
