"""Integration step by step, with the interface of SciPy's OdeSolver."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Iterable
from typing import Any, Never, Unpack

import numpy as np
from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.frames.base import Frame
from cg.integration.arguments import check_real_time, check_resolution, check_step, is_many
from cg.integration.loop.dense import DenseOutput
from cg.integration.open_run import OpenRun
from cg.integration.options import StepOptions, complete_options, expand_options
from cg.integration.problem import make_problem
from cg.integration.rhs.function import CompiledFunction, Function
from cg.integration.rhs.python import Coefficients
from cg.integration.rhs.samples import Samples
from cg.integration.step.implicit import DEFAULT_STAGE_SOLVER
from cg.integration.stepper_state import check_data, check_new_y, get_state, replace_rhs, restored
from cg.support.arrays import Array, Points
from cg.support.checks import check_flag
from cg.support.times import apart


class Stepper(OpenRun):
    """An integration that advances step by step, or to given times.

    Parameters
    ----------
    f, frame, method, rtol, atol, h, max_step, first_step, args, breakpoints, stage_solver, jac
        As for `cg.solve_ivp`.
    inputs
        As for `cg.solve_ivp`; they need not lead to ``t_bound``, but as far as the stepper does.
    t0
        Initial time.
    y0
        Initial point, shape ``frame.point_shape``, or those of the members of an ensemble, which
        have one leading axis.
    t_bound
        Final time. By default there is none, and time increases.
    parameters
        As for `cg.solve_ivp`, of an ensemble for `cg.solve_ensemble`.
    vectorized, common_steps
        As for `cg.solve_ensemble`.
    events
        As for `cg.solve_ivp`, for a single point. ``step`` and ``advance`` stop at a terminal
        event, behind its jump if it has one, and go on from there when they are called again; an
        event that is terminal the third time stops each third time.

    Attributes
    ----------
    t, y
        Present time and point; ``y`` is a read-only copy.
    t_old
        Start of the last step, None before the first one and after a restart.
    step_size
        Absolute size of the last step, None before the first one.
    next_step
        Absolute size that the next step tries, unless its end comes before; None if it isn't chosen
        yet. Of an ensemble those of the members, shape ``(members,)``, with NaN in place of None.
    direction
        1.0 or -1.0.
    n
        Number of coefficients, ``frame.dim``.
    status
        ``"running"``, ``"event"`` at a terminal event, ``"finished"`` at ``t_bound``, or
        ``"failed"``.
    t_events, y_events, y_after
        For each event its times so far, and the points before and after its jumps, as in a
        `Solution`; None without events.
    nfev, njev, nlu, nexp, nrejected
        Counts so far, for an ensemble summed over the members.

    Raises
    ------
    TypeError, ValueError
        As `cg.solve_ivp` does.

    Notes
    -----
    If the error estimate can't be met, ``step`` and ``advance`` return a message, and ``status`` is
    ``"failed"``. After that, or an exception or interrupt of ``f``, ``t`` and ``y`` are those of
    the last complete step, or of an ensemble those before the call. After an exception further
    steps may be tried, and after a failure ``restart`` may be called.

    A pickle contains the present state and ``f``, which has to be a function of a module or a
    `CompiledFunction`; the copy goes on bit for bit. ``copy.copy`` takes any ``f``.

    Examples
    --------
    A control law with a sampling time of a tenth of a second:

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
    >>> def f(t, y, torque):
    ...     return np.concatenate([y[4:], torque])
    >>> stepper = cg.Stepper(
    ...     f, 0.0, [0, 0, 0, 1, 0.3, 0, 0.1], frame=frame, method="CF4", h=0.1,
    ...     args=(np.zeros(3),),
    ... )
    >>> for k in range(1, 101):
    ...     stepper.restart(args=(-0.5 * stepper.y[:3] - stepper.y[4:],))
    ...     stepper.advance(0.1 * k)
    >>> bool(np.abs(stepper.y[4:]).max() < 0.02)
    True
    """

    @expand_options
    def __init__(
        self,
        f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
        t0: float,
        y0: ArrayLike,
        t_bound: float = math.inf,
        *rest: Never,
        frame: Frame,
        stage_solver: str = DEFAULT_STAGE_SOLVER,
        jac: Function | ArrayLike | None = None,
        vectorized: bool = False,
        common_steps: bool = False,
        events: Any = None,
        **options: Unpack[StepOptions],
    ) -> None:
        given = complete_options(Stepper.__init__, rest, options, StepOptions)
        start = check_real_time(t0, "t0", infinite=False)
        bound = check_real_time(t_bound, "t_bound")
        self.direction = -1.0 if bound < start else 1.0
        vectorized = check_flag("vectorized", vectorized)
        common = check_flag("common_steps", common_steps)
        many = is_many(frame, y0)
        if (vectorized or common) and not many:
            raise ValueError("vectorized and common_steps must be False for a single point")
        if many and events is not None:
            raise ValueError("events must be None for an ensemble, whose members stop apart")
        given["events"] = events
        first_step, breakpoints = given["first_step"], given["breakpoints"]
        given["breakpoints"] = None
        given["first_step"] = None if given["h"] is None else first_step  # may exceed the span here
        problem = make_problem(
            f, (start, start), y0, frame=frame, options=given, many=many,
            vectorized=vectorized, common=common, stage_solver=stage_solver, jac=jac,
        )  # fmt: skip
        check_resolution(problem.control.h, start)
        check_data(problem.rhs, many)
        self.f = f
        first = None if first_step is None else check_step(first_step, "first_step")
        self._open(problem, bound, breakpoints, first)

    @property
    def y(self) -> Points:
        """The present point, a read-only copy."""
        run = self._run
        lead = (run.members,) if self._many else ()
        points = run.plan.points(run.end.copy(), lead)
        points.flags.writeable = False
        return points

    @property
    def n(self) -> int:
        """Number of coefficients."""
        return self.frame.dim

    def __repr__(self) -> str:
        return f"Stepper(t={self.t!r}, status={self.status!r}, method={self.table.name!r})"

    t_events = property(lambda self: self._event_lists("t"), doc="Times of each event.")
    y_events = property(lambda self: self._event_lists("before"), doc="Points before jumps.")
    y_after = property(lambda self: self._event_lists("after"), doc="Points after jumps.")

    @property
    def next_step(self) -> float | Array | None:
        """Absolute size that the next step tries."""
        h, sizes = self._run.control.h, self._run.state()[0][:, 1]
        sizes = np.where(sizes > 0.0, sizes, np.nan) if h is None else np.full(len(sizes), h)
        if self._many:
            return sizes
        return None if np.isnan(sizes[0]) else float(sizes[0])

    def _count(self, k: int) -> int:
        return int(self._run.counts[:, k].sum())

    nfev = property(lambda self: self._count(0), doc="Evaluations of the coefficients.")
    nexp = property(lambda self: self._count(1), doc="Flows.")
    njev = property(lambda self: self._count(2), doc="Jacobians of stage equations.")
    nlu = property(lambda self: self._count(3), doc="Factorisations of them.")
    nrejected = property(lambda self: self._count(5), doc="Rejected steps.")

    def step(self) -> str | None:
        """Take one step, up to the first event in it that is terminal or jumps.

        Returns
        -------
        str or None
            Why the step failed, None if it was taken.

        Raises
        ------
        RuntimeError
            If the integration has ended, or its members have steps of their own.
        """
        if self._many and not self._common:
            raise RuntimeError(
                "step is for one point or common_steps; members with steps of their own advance(t)"
            )
        self._check_running()
        if self.t == self._stops.item(-1):
            raise RuntimeError(
                f"inputs must lead beyond t = {self.t:.17g} for another step; restart with others"
            )
        if not self._stops_are_set:
            self._continue(self._stops)
            self._stops_are_set = True
        return self._drive(None)

    def advance(self, t: float) -> str | None:
        """Take steps up to a time, or to a terminal event.

        The last step ends there; that it is shortened doesn't shorten the next one.

        Parameters
        ----------
        t
            Time, not before ``.t`` and not beyond ``t_bound``.

        Returns
        -------
        str or None
            Why the time wasn't reached, None if it was.

        Raises
        ------
        ValueError
            If ``t`` lies before ``.t`` or beyond ``t_bound``.
        RuntimeError
            If the integration has ended.
        """
        target = check_real_time(t, "t", infinite=False)
        if self.status == "finished" and target != self.t:
            self._check_running()
        if self.direction * (target - self.t) < 0.0 or (
            self.direction * (target - self.t_bound) > 0.0
        ):
            low, high, got = apart(self.t, self.t_bound, target)
            raise ValueError(f"t must lie between {low} and {high}, got {got}")
        if target == self.t:
            return None
        self._check_running()
        if (inputs := self._run.rhs.inputs) is not None:
            inputs.check_span(self.t, target, "t")
        check_resolution(self._run.control.h, target)
        if len(self._stops) == 1:
            self._target[0] = target
            stops = self._target
        else:
            # a breakpoint at the target is repeated, so that the step up to it ends before it
            reached = self._stops[self.direction * (self._stops - target) <= 0.0]
            stops = np.append(reached, target)
        self._continue(stops)
        self._stops_are_set = False
        return self._drive(target)

    def restart(
        self,
        *,
        t: float | None = None,
        y: ArrayLike | None = None,
        args: Iterable[Any] | None = None,
        parameters: ArrayLike | None = None,
        first_step: float | None = None,
        inputs: Samples | tuple[Samples, ...] | None = None,
    ) -> None:
        """Continue from another time or point, or with other arguments of ``f``.

        Arguments that are None stay as they are, and so do the counts, except that terminal events
        are counted anew. ``f`` isn't called before the next step, which uses no slope of earlier
        ones; only forces on a phase space that get other arguments, for a splitting method.

        Parameters
        ----------
        t, y
            Time and point.
        args, parameters
            Arguments of ``f``.
        inputs
            Samples of the same shapes as before, which must cover the time.
        first_step
            Size of the next step. By default it is ``h`` or `next_step`: the size is kept. With
            a new ``t`` or without any argument, after a failure or a jump, it is the ``first_step``
            of the constructor, or chosen anew, which takes one call of ``f``. Give it where a new
            point or other arguments change the solution much faster than before.

        Raises
        ------
        TypeError, ValueError
            If an argument has an impossible value, or ``f`` doesn't take as many ``args``.
        """
        run, time, rows = self._run, self.t, self._run.end
        if t is not None:
            time = check_real_time(t, "t", infinite=False)
            if self.direction * (self.t_bound - time) < 0.0:
                bound, got = apart(self.t_bound, time)
                raise ValueError(f"t must not be beyond t_bound = {bound}, got {got}")
            check_resolution(run.control.h, time)
            if inputs is None and run.rhs.inputs is not None:
                run.rhs.inputs.check_span(time, time, "t")
        if y is not None:
            rows = run.plan.doubles(check_new_y(self, y))
        first = self._first_step if first_step is None else check_step(first_step, "first_step")
        replaced = any(each is not None for each in (y, args, parameters, inputs))
        if first_step is None and t is None and replaced and self.status != "failed":
            same_f = args is None and parameters is None and inputs is None
            first = -1.0 if same_f else -2.0  # keeps the sizes proposed
        replace_rhs(self, time, rows, args, parameters, inputs)
        self.t, self.t_old, self._cut_output = time, None, None
        if t is not None and run.control.h is not None and math.isinf(self.t_bound):
            far = self._end_from(time, run.control.h)
            self._breakpoints = self._stops = np.append(self._breakpoints[:-1], far)
        if run.rhs.inputs is not None and (t is not None or inputs is not None):
            self._stops = self._with_corners(run.rhs.inputs, time)
        self._begin(time, rows, first)
        self.status = "running" if self.t != self.t_bound else "finished"

    def dense_output(self) -> DenseOutput:
        """Return the solution within the last step.

        It takes evaluations of ``f``.

        Raises
        ------
        RuntimeError
            If no step has been taken since the beginning or the last restart, or members have
            steps of their own.
        """
        if self.t_old is None or (self._many and not self._common):
            raise RuntimeError("dense_output must come after a step that all members share")
        return self._cut_output or self._interpolate()

    def _check_running(self) -> None:
        if self.status not in ("running", "event"):
            why = f": {self._failure}" if self.status == "failed" else ""
            raise RuntimeError(
                f"the integration has {self.status} at t = {self.t:.17g}{why}; restart it"
            )

    def __reduce__(self) -> tuple[Any, ...]:
        try:
            pickle.dumps(self.f)
        except Exception as error:
            raise TypeError(
                "f must be such that it can be pickled, a function of a module or a compiled one "
                f"as cg.CompiledFunction(path, symbol), got {self.f!r}: {error}"
            ) from error
        return restored, (Stepper, get_state(self))

    def __copy__(self) -> Any:
        return restored(Stepper, get_state(self))

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return restored(Stepper, copy.deepcopy(get_state(self), memo))
