"""The results of integrations, and continuous solutions that stay on the manifold."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.frames.base import Frame
from cg.integration.errors import FINISHED
from cg.integration.plan.callbacks import Callbacks
from cg.integration.plan.plan import Plan
from cg.support.arrays import Array, Points, clipped, read_only, real_array
from cg.support.checks import texts_of
from cg.support.frozen import ReadOnly, filled
from cg.support.shared_numbers import InterpolantColumn
from cg.support.shared_records import COUNTS
from cg.tables import MethodTable, source_method


@dataclass(frozen=True, eq=False)
class Interpolants:
    """The interpolants by which compiled code evaluates the solution within steps."""

    plan: Plan
    rows: Array  # `InterpolantColumn`, points as doubles, and vectors; members increase

    @property
    def ends(self) -> Array:
        """The times at which steps end."""
        return self.rows[:, InterpolantColumn.END]

    def member(self, member: int) -> Interpolants:
        """Return the interpolants of one member."""
        members = self.rows[:, InterpolantColumn.MEMBER]
        rows = slice(*np.searchsorted(members, [member + 1, member + 2]).tolist())
        return Interpolants(self.plan, self.rows[rows])

    def at(self, steps: NDArray[np.intp], t: Array) -> Points:
        """Return points at times within steps, by indices of steps, shape ``(n, *point_shape)``."""
        plan = self.plan
        start, size = InterpolantColumn.START, InterpolantColumn.SIZE
        theta = np.clip((t - self.rows[steps, start]) / self.rows[steps, size], 0.0, 1.0)
        rows = np.full((len(t), plan.width), math.nan)
        callbacks = None if plan.compiled else Callbacks(plan)
        if plan.interpolant_vectors and len(t) and plan.core.plan_interpolate(
            plan.address, 0 if callbacks is None else id(callbacks), steps, theta,
            self.rows.T, rows.T,
        ):  # fmt: skip
            raise MemoryError("there is not enough memory to evaluate the solution")
        return plan.points(rows, (len(t),))


def _range(times: Array) -> str:
    """Return the first and the last time for a message."""
    return "...".join(texts_of(times[0], times[-1])) if len(times) else "nothing"


class DenseOutput(ReadOnly):
    """A solution as a function of time, on the manifold at all times and as accurate as the steps.

    The solution of ``"RadauIIA5"`` is of order three between steps. ``f`` isn't called. With
    ``derivatives="forward"`` derivatives are functions of time as well.

    Parameters
    ----------
    interpolants
        The interpolants of all steps.
    t0
        Initial time.
    direction
        1.0 forward in time, -1.0 backward.
    y0
        Initial point.
    jumps
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

    _splitter: Any = None  # a `DerivativeSplitter` if points hold derivatives

    def __init__(
        self, interpolants: Interpolants, t0: float, direction: float, y0: Points,
        jumps: tuple[Array, Points] | None = None,
    ) -> None:  # fmt: skip
        self.ts = read_only(np.concatenate([[t0], interpolants.ends]))
        self.t_min = float(self.ts.min())
        self.t_max = float(self.ts.max())
        self._interpolants = interpolants
        self._y0 = y0
        self._jumps = jumps
        self._direction = direction

    def __repr__(self) -> str:
        return f"DenseOutput(t={_range(self.ts)}, steps={len(self.ts) - 1})"

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
        return self._points(t) if self._splitter is None else self._split("y", t)

    def transition(self, t: ArrayLike) -> Any:
        """Return transition matrices, shape ``(*t.shape, dim, dim)``; None without derivatives."""
        return self._split("transition", t)

    def sensitivity(self, t: ArrayLike) -> Any:
        """Return derivatives by parameters, shape ``(*t.shape, dim, k)``; None without any."""
        return self._split("sensitivity", t)

    def covariance(self, t: ArrayLike) -> Any:
        """Return covariances, shape ``(*t.shape, dim, dim)``; None without ``P0`` and noise."""
        return self._split("covariance", t)

    def with_derivatives(self, splitter: Any) -> Self:
        """Return the solution, whose points hold derivatives, as functions of time."""
        output = copy.copy(self)
        output._splitter = splitter
        return output

    def _split(self, name: str, t: ArrayLike) -> Any:
        return self._splitter and self._splitter.split(self._points(t))[name]

    def _points(self, t: ArrayLike) -> Points:
        times = real_array(t, "t")
        inside, outside = clipped(times.ravel(), self.t_min, self.t_max)
        if outside is not None:
            low, high, got = texts_of(self.t_min, self.t_max, times.flat[outside])
            raise ValueError(f"t must lie between {low} and {high}, got {got}")
        return self._evaluate(inside).reshape(*times.shape, *self._y0.shape)

    def _evaluate(self, flat: Array) -> Points:
        if len(self.ts) == 1:
            return np.asarray(np.repeat(self._y0[None], flat.size, axis=0))
        steps = np.searchsorted(self._direction * self.ts, self._direction * flat) - 1
        points = self._interpolants.at(np.maximum(steps, 0), flat)
        for time, point in zip(*(self._jumps or ((), ())), strict=True):
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
        return read_only(ts[:: int(self._direction)])

    @cached_property
    def _y0(self) -> Points:  # type: ignore[override]
        return np.stack([member._y0 for member in self._members])

    def __repr__(self) -> str:
        return f"EnsembleOutput(t={_range(self.ts)}, members={len(self._members)})"

    def __getitem__(self, member: int) -> DenseOutput:
        output, splitter = self._members[member], self._splitter
        return output if splitter is None else output.with_derivatives(splitter.member(member))

    def _evaluate(self, flat: Array) -> Points:
        points = np.full((flat.size, *self._y0.shape), math.nan, dtype=self._y0.dtype)
        for i, member in enumerate(self._members):
            inside = (flat >= member.t_min) & (flat <= member.t_max)
            points[inside, i] = member(flat[inside])
        return points


_EVENT_FIELDS = "t_events", "y_events", "y_after", "dt_events"
_DERIVATIVES = "transition", "sensitivity", "covariance"


@dataclass(frozen=True, eq=False)
class _SolutionBase(ReadOnly):
    """The fields of a `Solution` and of an `EnsembleSolution`, which has an axis for members."""

    t: Array
    y: Points
    sol: Any
    t_events: list[Any] | None
    y_events: list[Any] | None
    y_after: list[Any] | None
    nfev: Any
    njev: Any
    nlu: Any
    nexp: Any
    steps: Any
    nrejected: Any
    status: Any
    message: str
    success: bool
    table: MethodTable
    frame: Frame
    h: float | None = None
    observed: Array | None = None
    transition: Any = None  # not Array | None, with which type checkers refuse transition[-1]
    sensitivity: Any = None
    covariance: Any = None
    dt_events: list[Any] | None = None

    @property
    def method(self) -> Any:
        """The method, a `cg.Method`."""
        return source_method(self.table)


@dataclass(frozen=True, eq=False)
class Solution(_SolutionBase):
    """The solution of an initial value problem, with the field names of SciPy's function.

    The derivative of ``y[i]`` with respect to a number has coordinates ``xi`` in the frame if it is
    the tangent ``frame.field(xi, y[i])``.

    Attributes
    ----------
    t
        Times, shape ``(n,)``, read-only.
    y
        Points, shape ``(n, *point_shape)``, read-only. Time is the *first* axis, unlike in
        SciPy, since points are arrays of any shape. It is None with ``store="observed"``.
    sol
        The continuous solution, None without ``dense_output``.
    t_events
        For each event the times at which it happened, or None without events.
    y_events, y_after
        For each event the points, shape ``(n_i, *point_shape)``, or None without events; those
        after its jumps in ``y_after``.
    nfev
        Evaluations of the coefficients.
    njev, nlu
        Jacobians of stage equations and their factorisations; zero for explicit methods.
    nexp
        Number of flows (exponentials) of steps and of the continuous solution, rejected steps
        included.
    steps
        Accepted steps.
    nrejected
        Rejected steps.
    status
        0: the end was reached; 1: an event ended the integration; -1: the integration
        failed, for the reason in ``message``; ``t`` and ``y`` hold the accepted steps.
    message
        The status as a sentence.
    success
        Whether ``status`` is at least 0.
    method
        The method.
    frame
        The frame that holds the points.
    h
        Absolute size of equal steps, None for adaptive ones.
    observed
        The values of ``observe`` at the times ``t``, shape ``(n, ...)``, or None.
    transition
        With ``derivatives="forward"``, else None as the following: derivatives of the coordinates
        of ``y`` with respect to those of ``y0``, shape ``(n, dim, dim)``, read-only.
    sensitivity
        The same with respect to the parameters, shape ``(n, dim, k)``, or None without any; or
        along directions of ``derivatives_by``, a column for each.
    covariance
        ``transition @ P0 @ transition.T`` at each time, and what noise adds to it, shape
        ``(n, dim, dim)``; or None without ``P0`` and noise.
    dt_events
        For each event the derivatives of its times with respect to the coordinates of ``y0``, then
        the parameters, shape ``(n_i, dim + k)``, or None without events.
    adjoint
        With ``derivatives="adjoint"`` a `cg.Adjoint`, else None; so are its methods ``gradient``
        and ``jacobian``, which the solution has as well.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> solution = cg.solve_ivp(
    ...     lambda t, y: [0.0, np.sin(t), y[0, 0]], (0, 5), np.eye(3), frame=cg.frames.SO3(),
    ...     method="CF4(3)", rtol=1e-6, atol=1e-6, t_eval=[0, 2.5, 5],
    ... )
    >>> solution.success, solution.y.shape, solution.nfev > 4 * solution.steps
    (True, (3, 3, 3), True)
    >>> solution.message
    'The end of t_span was reached.'

    A body makes half a turn about its z axis; small errors in body axes rotate in the opposite
    direction.

    >>> solution = cg.solve_ivp(
    ...     lambda t, y, rate: [0.0, 0.0, rate[0]], (0, np.pi), np.eye(3), frame=cg.frames.SO3(),
    ...     parameters=[1.0], derivatives="forward", P0=np.diag([1e-4, 4e-4, 1e-4]), rtol=1e-9,
    ...     atol=1e-9, control_derivatives=True,
    ... )
    >>> solution.transition[-1].round(9) + 0.0
    array([[-1.,  0.,  0.],
           [ 0., -1.,  0.],
           [ 0.,  0.,  1.]])
    >>> solution.sensitivity[-1].ravel().round(6) + 0.0
    array([0.      , 0.      , 3.141593])
    """

    sol: DenseOutput | None
    nfev: int
    njev: int
    nlu: int
    nexp: int
    steps: int
    nrejected: int
    status: int
    adjoint: Any = None

    @property
    def gradient(self) -> Any:
        """`Adjoint.gradient`."""
        return self.adjoint and self.adjoint.gradient

    @property
    def jacobian(self) -> Any:
        """`Adjoint.jacobian`."""
        return self.adjoint and self.adjoint.jacobian

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}(t={_range(self.t)}, status={self.status}, steps={self.steps}, "
            f"nrejected={self.nrejected}, nfev={self.nfev}, nexp={self.nexp})"
        )


@dataclass(frozen=True, eq=False)
class EnsembleSolution(_SolutionBase):
    """The solutions of many problems; ``solution[i]`` is the `Solution` of a member.

    Attributes
    ----------
    t
        Times, those of ``t_eval`` or the ends of ``t_span``, shape ``(n,)``, read-only.
    y
        Points, shape ``(n, members, *point_shape)``, read-only unless it is ``out``; NaN at times
        that a member didn't reach; None with ``store="observed"``.
    sol
        The continuous solution of all members, None without ``dense_output``.
    t_end
        The last time of each member, shape ``(members,)``.
    status, nfev, njev, nlu, nexp, steps, nrejected
        As those of `Solution`, shape ``(members,)``.
    messages
        Messages of the members whose status isn't 0, by their indices.
    message
        The messages in one sentence.
    success
        Whether all members succeeded.
    t_events, y_events, y_after, dt_events
        For each event a list of the members' arrays, or None without events.
    method, frame, h
        As those of `Solution`.
    observed
        The values of ``observe``, shape ``(n, members, ...)``, or None.
    transition, sensitivity, covariance
        As those of `Solution`, with the members as second axis; NaN at times that a member didn't
        reach.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> solution = cg.solve_ensemble(
    ...     lambda t, y, rate: [0.0, np.sin(t), rate[0]], (0, 5), np.eye(3), frame=cg.frames.SO3(),
    ...     parameters=[[0.5], [1.0]], t_eval=[0, 2.5, 5],
    ... )
    >>> solution.y.shape, solution.status.tolist(), solution[1].y.shape
    ((3, 2, 3, 3), [0, 0], (3, 3, 3))
    """

    sol: EnsembleOutput | None
    t_end: Array = field(kw_only=True)
    messages: dict[int, str] = field(kw_only=True)
    _direction: float = field(kw_only=True)  # 1.0 forward in time, -1.0 backward

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}(t={_range(self.t)}, members={len(self)}, "
            f"success={self.success}, steps={int(self.steps.sum())}, nfev={int(self.nfev.sum())})"
        )

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, member: int) -> Solution:
        allowed = range(-len(self), len(self))
        if not isinstance(member, int | np.integer) or member not in allowed:
            error = IndexError if isinstance(member, int | np.integer) else TypeError
            raise error(f"member must be an integer in {allowed}, got {member!r}")
        member = range(len(self))[member]  # from 0, also if it was negative
        counts = [getattr(self, name).item(member) for name in COUNTS]
        ends = self._direction, self.t_end.item(member), self.status.item(member), counts
        fields = member_fields(self, member, *ends)
        fields |= {"table": self.table, "frame": self.frame, "h": self.h}
        for name in _EVENT_FIELDS:
            lists = getattr(self, name)
            fields[name] = None if lists is None else [members[member] for members in lists]
        for name in _DERIVATIVES:
            array = getattr(self, name)
            fields[name] = None if array is None else array[: len(fields["t"]), member]
        fields["sol"] = None if self.sol is None else self.sol[member]
        return filled(Solution, fields)


def member_fields(
    results: Any, member: int, direction: float, end: float, status: int, counts: list[int]
) -> dict[str, Any]:
    """Return fields of the solution of a member up to its last time, from results of all."""
    t, y, observed = results.t, results.y, results.observed
    if len(t) and t.item(-1) != end:
        t = t[: int((direction * (t - end) <= 0.0).sum())]
    if y is not None:
        y = np.ascontiguousarray(y[: len(t), member])
        y.setflags(write=False)
    if observed is not None:
        observed = np.ascontiguousarray(observed[: len(t), member])
        observed.setflags(write=False)
    message = results.messages.get(member, FINISHED)
    fields = {
        "t": t,
        "y": y,
        "observed": observed,
        "status": status,
        "message": f"Failure: {message}." if status < 0 else message,
        "success": status >= 0,
    }
    fields.update(zip(COUNTS, counts, strict=True))
    return fields
