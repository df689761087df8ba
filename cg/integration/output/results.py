"""The results of integrations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cg.frames.base import Frame
from cg.integration.output.dense import DenseOutput, EnsembleOutput
from cg.integration.run.messages import FINISHED
from cg.support.arrays import Array, Points
from cg.support.copies import ReadOnly, filled
from cg.support.shared_records import COUNTS
from cg.support.times import apart
from cg.tables import MethodTable, made

_EVENT_FIELDS = "t_events", "y_events", "y_after", "dt_events"
_DERIVATIVES = {  # with their last axes
    "transition": "initial_coordinate",
    "sensitivity": "parameter",
    "covariance": "other_coordinate",
}
_NUMBERS = ("nfev", "njev", "nlu", "nexp", "steps", "nrejected", "status", "message", "h")


@dataclass(frozen=True, eq=False)
class _Results(ReadOnly):
    """What is known of one solution, and of those of many members with an axis for these."""

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
        return made(self.table)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` with the variable ``y`` and named axes, ``t`` first.

        Of an ensemble ``member`` is second; the last are ``component`` of vectors, ``row`` and
        ``column`` of matrices. Derivatives of solutions are the variables ``transition``,
        ``sensitivity`` and ``covariance`` with the axes ``coordinate`` and ``initial_coordinate``,
        ``parameter`` or ``other_coordinate``. Attributes are the name of the method, the frame,
        and what the integration took; of an ensemble these numbers are variables.
        """
        import xarray

        axes = len(self.frame.point_shape)
        members = ["member"] if np.ndim(self.status) else []
        points = {0: [], 1: ["component"], 2: ["row", "column"]}.get(
            axes, [f"axis_{k}" for k in range(axes)]
        )
        attributes = {"method": self.table.name, "frame": repr(self.frame)}
        variables = {} if self.y is None else {"y": (["t", *members, *points], self.y)}
        if self.observed is not None:
            last = [f"observable_{k}" for k in range(np.ndim(self.observed) - 1 - len(members))]
            variables["observed"] = (["t", *members, *last], self.observed)
        for name, axis in _DERIVATIVES.items():
            value = getattr(self, name)
            if value is not None:
                variables[name] = (["t", *members, "coordinate", axis], value)
        for name in _NUMBERS:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                variables[name] = (members, value)
            elif value is not None:
                attributes[name] = value
        return xarray.Dataset(variables, {"t": self.t}, attributes)


@dataclass(frozen=True, eq=False)
class Solution(_Results):
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
        0: the end was reached; 1: an event ended the integration; -1: the step size became too
        small or the number of steps too large, and ``t`` and ``y`` hold the accepted steps.
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
        What ``observe`` returned at the times ``t``, shape ``(n, ...)``, or None.
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
        times = "...".join(apart(self.t[0], self.t[-1])) if len(self.t) else "nothing"
        return (
            f"{type(self).__name__}(t={times}, status={self.status}, steps={self.steps}, "
            f"nrejected={self.nrejected}, nfev={self.nfev}, nexp={self.nexp})"
        )


@dataclass(frozen=True, eq=False)
class EnsembleSolution(_Results):
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
        What ``observe`` returned, shape ``(n, members, ...)``, or None.
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
    t_end: Array = field(kw_only=True)  # the last time of each member
    messages: dict[int, str] = field(kw_only=True)
    _direction: float = field(kw_only=True)  # 1.0 forward in time, -1.0 backward

    def __repr__(self) -> str:
        times = "...".join(apart(self.t[0], self.t[-1])) if len(self.t) else "nothing"
        return (
            f"{type(self).__name__}(t={times}, members={len(self)}, success={self.success}, "
            f"steps={int(self.steps.sum())}, nfev={int(self.nfev.sum())})"
        )

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, member: int) -> Solution:
        return filled(Solution, self._fields_of(range(len(self))[member]))

    def _fields_of(self, member: int) -> dict[str, Any]:
        """Return the fields of the solution of a member."""
        events = {name: getattr(self, name) for name in _EVENT_FIELDS}
        for name, lists in events.items():
            events[name] = None if lists is None else [members[member] for members in lists]
        counts = [int(getattr(self, name)[member]) for name in COUNTS]
        ends = self._direction, self.t_end[member], self.status[member], counts
        fields = member_fields(self, member, *ends)
        fields |= {"table": self.table, "frame": self.frame, "h": self.h}
        for name in _DERIVATIVES:
            array = getattr(self, name)
            fields[name] = None if array is None else array[: len(fields["t"]), member]
        return fields | events | {"sol": None if self.sol is None else self.sol[member]}


def member_fields(
    joint: Any, member: int, direction: float, end: float, status: Any, counts: list[int]
) -> dict[str, Any]:
    """Return fields of the solution of a member up to its last time, of what all have jointly."""
    t, y, observed = joint.t, joint.y, joint.observed
    if len(t) and t[-1] != end:
        t = t[: int((direction * (t - end) <= 0.0).sum())]
    if y is not None:
        y = np.ascontiguousarray(y[: len(t), member])
        y.setflags(write=False)
    if observed is not None:
        observed = np.ascontiguousarray(observed[: len(t), member])
        observed.setflags(write=False)
    message = joint.messages.get(member, FINISHED)
    return {
        "t": t,
        "y": y,
        "observed": observed,
        **dict(zip(COUNTS, counts, strict=True)),
        "status": int(status),
        "message": f"Failure: {message}." if status < 0 else message,
        "success": bool(status >= 0),
    }
