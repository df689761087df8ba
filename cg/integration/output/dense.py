"""Continuous solutions that stay on the manifold."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.integration.plan.callbacks import Callbacks
from cg.integration.plan.plan import Plan
from cg.support.arrays import Array, Points, real_array
from cg.support.copies import ReadOnly
from cg.support.times import apart, clipped


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps with the interpolants by which compiled code evaluates the solution within them."""

    plan: Plan
    member: NDArray[np.int64]  # the member of each step, increasing, shape (n,)
    # start, signed size, end (an event may end a step before its full size), and 1 if the
    # interpolant is in coordinates, shape (n, 4)
    t: Array
    y: Array  # points at both ends of the full step, as doubles, shape (n, 2, width)
    field: Array  # the interpolants' vectors, shape (n, columns dim)

    @classmethod
    def none(cls, plan: Plan) -> Steps:
        """Return no steps."""
        shapes = (4,), (2, plan.width), (plan.columns * plan.dim,)
        return cls(plan, np.empty(0, np.int64), *(np.empty((0, *shape)) for shape in shapes))

    def of(self, member: int) -> Steps:
        """Return the steps of one member."""
        first, last = np.searchsorted(self.member, [member, member + 1]).tolist()
        part = slice(first, last)
        return Steps(self.plan, self.member[part], self.t[part], self.y[part], self.field[part])

    def at(self, which: NDArray[np.intp], t: Array) -> Points:
        """Return points at times within steps, shape ``(n, *point_shape)``."""
        import cg._core_r64 as core

        start, size = self.t[which, 0], self.t[which, 1]
        theta = np.clip((t - start) / size, 0.0, 1.0)
        rows = np.full((len(t), self.plan.width), math.nan)
        callbacks = None if self.plan.compiled else Callbacks(self.plan)
        if len(t) and self.plan.columns:
            core.plan_interpolate(
                self.plan.address, 0 if callbacks is None else id(callbacks), which, theta,
                self.t.T, self.y.T, self.field.T, rows.T,
            )  # fmt: skip
        return self.plan.points(rows, (len(t),))


class DenseOutput(ReadOnly):
    """A solution as a function of time, on the manifold at all times and as accurate as the steps.

    It doesn't call ``f``. With ``derivatives="forward"`` these are functions of time as well.

    Parameters
    ----------
    steps
        The steps.
    t0
        Initial time.
    direction
        1.0 forward in time, -1.0 backward.
    y0
        Initial point.
    marks
        Times of events that end steps, shape ``(k,)``, and the points after their jumps.

    Attributes
    ----------
    ts
        The times of the steps, shape ``(steps + 1,)``, read-only.
    t_min, t_max
        The interval of the solution.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.UnitQuaternion()
    >>> solution = cg.solve_ivp(
    ...     lambda t, q: [np.cos(t), 0.5, np.sin(t)], (0, 10), [0.0, 0.0, 0.0, 1.0],
    ...     frame=frame, rtol=1e-8, atol=1e-8, dense_output=True,
    ... )
    >>> between = solution.sol([2.5, 5.0, 7.5])
    >>> between.shape, bool((frame.membership_error(between) < 1e-14).all())
    ((3, 4), True)
    """

    _derivatives: Any = None  # splits points that hold derivatives

    def __init__(
        self,
        steps: Steps,
        t0: float,
        direction: float,
        y0: Points,
        marks: tuple[Array, Points] | None = None,
    ) -> None:
        self.ts = np.concatenate([[t0], steps.t[:, 2]])
        self.ts.flags.writeable = False
        self.t_min = float(self.ts.min())
        self.t_max = float(self.ts.max())
        self._steps = steps
        self._y0 = y0
        self._marks = marks
        self._direction = direction

    def __repr__(self) -> str:
        times = "...".join(apart(self.ts[0], self.ts[-1]))
        return f"DenseOutput(t={times}, steps={len(self.ts) - 1})"

    def __call__(self, t: ArrayLike) -> Points:
        """Return the solution.

        Parameters
        ----------
        t
            Times, of any shape, between ``t_min`` and ``t_max``.

        Returns
        -------
        ndarray
            Shape ``(*t.shape, *point_shape)``: time comes first. At an event with a jump it
            is the point after the jump.
        """
        return self._points(t) if self._derivatives is None else self._part("y", t)

    def transition(self, t: ArrayLike) -> Any:
        """Return transition matrices, shape ``(*t.shape, dim, dim)``; None without derivatives."""
        return self._part("transition", t)

    def sensitivity(self, t: ArrayLike) -> Any:
        """Return derivatives by parameters, shape ``(*t.shape, dim, k)``; None without any."""
        return self._part("sensitivity", t)

    def covariance(self, t: ArrayLike) -> Any:
        """Return covariances, shape ``(*t.shape, dim, dim)``; None without ``P0`` and noise."""
        return self._part("covariance", t)

    def with_derivatives(self, derivatives: Any) -> Self:
        """Return the solution, whose points hold derivatives, as functions of time."""
        made = copy.copy(self)
        made._derivatives = derivatives
        return made

    def _part(self, name: str, t: ArrayLike) -> Any:
        none = self._derivatives is None
        return None if none else self._derivatives.split(self._points(t))[name]

    def _points(self, t: ArrayLike) -> Points:
        times = real_array(t, "t")
        inside, outside = clipped(times.ravel(), self.t_min, self.t_max)
        if outside is not None:
            low, high, got = apart(self.t_min, self.t_max, times.flat[outside])
            raise ValueError(f"t must lie between {low} and {high}, got {got}")
        return self._evaluate(inside).reshape(*times.shape, *self._y0.shape)

    def _evaluate(self, flat: Array) -> Points:
        if len(self.ts) == 1:
            points: Points = np.repeat(self._y0[None], flat.size, axis=0)
            return points
        which = np.searchsorted(self._direction * self.ts, self._direction * flat) - 1
        points = self._steps.at(np.maximum(which, 0), flat)
        for time, point in zip(*(self._marks or ((), ())), strict=True):
            points[flat == time] = point
        return points


class EnsembleOutput(DenseOutput):
    """The solutions of the members of an ensemble as a function of time.

    It is NaN for a member beyond the time at which the member's integration ended.
    """

    def __init__(self, members: list[DenseOutput]) -> None:
        self.t_min = min(member.t_min for member in members)
        self.t_max = max(member.t_max for member in members)
        self._direction = members[0]._direction
        self._members = members

    @cached_property
    def ts(self) -> Array:  # type: ignore[override]
        """The times of all members' steps."""
        ts = np.unique(np.concatenate([member.ts for member in self._members]))
        ts = ts[:: int(self._direction)]
        ts.flags.writeable = False
        return ts

    @cached_property
    def _y0(self) -> Points:  # type: ignore[override]
        return np.stack([member._y0 for member in self._members])

    def __repr__(self) -> str:
        times = "...".join(apart(self.ts[0], self.ts[-1]))
        return f"EnsembleOutput(t={times}, members={len(self._members)})"

    def __getitem__(self, member: int) -> DenseOutput:
        one, derivatives = self._members[member], self._derivatives
        return one if derivatives is None else one.with_derivatives(derivatives.of(member))

    def _evaluate(self, flat: Array) -> Points:
        points = np.full((flat.size, *self._y0.shape), math.nan, dtype=self._y0.dtype)
        for i, member in enumerate(self._members):
            inside = (flat >= member.t_min) & (flat <= member.t_max)
            points[inside, i] = member(flat[inside])
        return points
