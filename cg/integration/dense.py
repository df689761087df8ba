"""Continuous solutions that stay on the manifold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points, real_array
from cg.integration.interpolant import Interpolant

__all__ = ["DenseOutput", "EnsembleOutput"]


class DenseOutput:
    """A solution as a function of time, on the manifold at all times and as accurate as the steps.

    It holds all that it needs, and not ``f``.

    Parameters
    ----------
    ts
        Times, strictly monotonic, shape ``(steps + 1,)``.
    interpolant
        The solution between them, the last step of which may go on beyond the last time; None if
        there are no steps.
    y0
        The initial point, which is the whole solution if there are no steps.
    last
        The point at the last time if that is within the last step, else None.
    ends
        Where the solutions of the members of an ensemble end that do so before the last time, by
        their indices.

    Attributes
    ----------
    ts
        The times of the steps, shape ``(steps + 1,)``.
    t_min, t_max
        Between which times there is a solution.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> frame = cg.frames.UnitQuaternion()
    >>> run = cg.solve_ivp(
    ...     lambda t, q: [np.cos(t), 0.5, np.sin(t)], (0, 10), [0.0, 0.0, 0.0, 1.0],
    ...     frame=frame, rtol=1e-8, atol=1e-8, dense_output=True,
    ... )
    >>> between = run.sol([2.5, 5.0, 7.5])
    >>> between.shape, bool((frame.membership_error(between) < 1e-14).all())
    ((3, 4), True)
    """

    def __init__(
        self,
        ts: ArrayLike,
        interpolant: Interpolant | None,
        y0: Points,
        last: Points | None = None,
        ends: dict[tuple[int, ...], float] | None = None,
    ) -> None:
        self.ts = np.array(ts, dtype=np.float64)
        self.ts.flags.writeable = False
        self.t_min = float(self.ts.min())
        self.t_max = float(self.ts.max())
        self._interpolant = interpolant
        self._y0 = y0
        self._last = last
        self._ends = ends or {}
        self._sign = -1.0 if self.ts[-1] < self.ts[0] else 1.0

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.ts.flags.writeable = False

    def __repr__(self) -> str:
        return f"DenseOutput(t={self.ts[0]:g}...{self.ts[-1]:g}, steps={len(self.ts) - 1})"

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
        if self._interpolant is None:
            points: Points = np.repeat(self._y0[None], flat.size, axis=0)
            return points
        which = np.searchsorted(self._sign * self.ts, self._sign * flat, side="left") - 1
        points = self._interpolant.at(np.maximum(which, 0), flat)
        if self._last is not None:
            points[flat == self.ts[-1]] = self._last
        for index, end in self._ends.items():
            beyond: Any = (self._sign * (flat - end) > 0.0, *index)
            points[beyond] = math.nan
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
        super().__init__(ts if forward else ts[::-1], None, y0)
        self._members = tuple(members)
        self._batch = batch

    def __repr__(self) -> str:
        return f"EnsembleOutput(t={self.ts[0]:g}...{self.ts[-1]:g}, members={len(self._members)})"

    def _evaluate(self, flat: Array) -> Points:
        points = np.full((flat.size, *self._y0.shape), math.nan, dtype=self._y0.dtype)
        rows = points.reshape(flat.size, len(self._members), *self._y0.shape[len(self._batch) :])
        for i, member in enumerate(self._members):
            inside = (flat >= member.t_min) & (flat <= member.t_max)
            rows[inside, i] = member(flat[inside])
        return points
