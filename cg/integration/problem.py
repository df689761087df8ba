"""The problem of an integration: its arguments after checking."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from cg.catalogue import find_method, resolve_method
from cg.frames.arrays import Array, Points, real_array
from cg.frames.base import Frame
from cg.frames.phase_space import PhaseSpace
from cg.integration.arguments import (
    check_algebra,
    check_args,
    check_atol,
    check_max_steps,
    check_points,
    check_rtol,
    check_span,
    check_step,
    check_stops,
    check_t_eval,
    check_unused,
)
from cg.integration.default_method import AUTO, choose_method
from cg.integration.loop.record import Control, Output
from cg.integration.loop.run import Run
from cg.integration.options import Options, StepOptions, complete_options
from cg.integration.rhs.compiled import CompiledRhs, compiled_rhs
from cg.integration.rhs.events import EventTable
from cg.integration.rhs.function import TimeFunction
from cg.integration.rhs.python import Coefficients, PythonRhs
from cg.integration.step.collocation import Jacobian, jacobian_of
from cg.integration.step.implicit import DEFAULT_STAGE_SOLVER, check_stage_solver
from cg.integration.step.plan import Plan, has_brackets, plan_of
from cg.method.magnus import MagnusMethod
from cg.method.method import Method
from cg.method.munthe_kaas import MuntheKaas
from cg.method.splitting import Splitting
from cg.method.warnings import check_order, check_pair
from cg.support.checks import check_flag


@dataclass(frozen=True, eq=False)
class Problem:
    """An integration of one point or of the members of an ensemble.

    Attributes
    ----------
    plan
        The frame and the method.
    rhs
        The right-hand side.
    points
        Initial points, shape ``(members, *point_shape)``.
    t0
        Initial time.
    stops
        Breakpoints, then the final time.
    control
        The step size control.
    f
        The right-hand side as the user passed it.
    events
        The events as the user passed them.
    args
        Further arguments of ``f`` and of the events.
    t_eval
        Output times, or None.
    dense
        Whether to store interpolants.
    stage_solver
        Iteration for implicit stages.
    common
        Whether all members take the same steps.
    jacobian
        The Jacobian for Newton's method, None for differences.
    """

    plan: Plan
    rhs: CompiledRhs | PythonRhs
    points: Points
    t0: float
    stops: Array
    control: Control
    f: Any
    events: Any = None
    args: tuple[Any, ...] = ()
    t_eval: Array | None = None
    dense: bool = False
    stage_solver: str = "newton"
    common: bool = False
    jacobian: Jacobian | None = None

    @property
    def t1(self) -> float:
        """Final time."""
        return float(self.stops[-1])

    def arguments(self) -> Callable[[int], tuple[Any, ...]]:
        """Return a function of a member that returns the further arguments of its events."""
        rhs = self.rhs
        if isinstance(rhs, PythonRhs):
            return rhs.arguments
        numbers = rhs.parameters
        if numbers is None:
            return lambda _: self.args
        rows = numbers.reshape(len(self.points), -1)
        return lambda member: (*self.args, rows[member])

    def event_table(self) -> EventTable:
        """Return the events with their further arguments."""
        return EventTable(self.events, self.plan.frame, self.arguments())

    def run(self, output: Output, table: EventTable | None = None, **options: Any) -> Run:
        """Return the run of all members, with further options of `Run`."""
        return Run(
            self.plan, self.rhs, self.points, self.t0, self.stops, self.control, output,
            events=table, common=self.common, stage_solver=self.stage_solver,
            of_time=isinstance(self.f, TimeFunction),
            jacobian=self.jacobian, **options,
        )  # fmt: skip

    def with_rhs(self, rhs: CompiledRhs | PythonRhs, args: tuple[Any, ...]) -> Problem:
        """Return the problem with another right-hand side, faster than by `replace`."""
        other = object.__new__(Problem)
        vars(other).update(vars(self), rhs=rhs, args=args)
        return other

    def __getstate__(self) -> dict[str, Any]:
        """Return what the plan and the right-hand side are made of, and all other fields."""
        frame, method = self.plan.frame, self.plan.method
        # a method is sent by its name, so that each process has one instance with its cached data
        known = find_method(method.name) is method
        state = {name: value for name, value in vars(self).items() if name not in ("plan", "rhs")}
        state["plan"] = frame, method.name if known else method
        state["rhs"] = self.rhs.parameters, self.rhs.vectorized
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        frame, method = state["plan"]
        numbers, vectorized = state["rhs"]
        args, members = state["args"] or None, len(state["points"])
        rhs, _ = make_rhs(state["f"], frame, args, numbers, vectorized, members)
        made = {"plan": plan_of(frame, resolve_method(method)), "rhs": rhs}
        for name, value in (state | made).items():
            object.__setattr__(self, name, value)


def make_rhs(
    f: Any, frame: Frame, args: Any, parameters: ArrayLike | None, vectorized: bool, members: int
) -> tuple[CompiledRhs | PythonRhs, tuple[Any, ...]]:
    """Return the right-hand side of some members, and their further arguments, after checking.

    ``parameters`` have shape ``(members, k)``.
    """
    extra = check_args(args)
    vectorized = vectorized or (isinstance(f, TimeFunction) and f.vectorized)
    numbers = None
    if parameters is not None:
        numbers = real_array(parameters, "parameters")
        if numbers.ndim != 2 or len(numbers) != members or numbers.size == 0:
            raise ValueError(f"parameters must have shape ({members}, k), got {numbers.shape}")
        numbers.flags.writeable = False
    compiled = compiled_rhs(f)
    if compiled is None:
        if not callable(f):
            raise TypeError(f"f must be callable as f(t, y), got {f!r}")
        return PythonRhs(cast(Coefficients, f), frame, extra, numbers, vectorized), extra
    if extra and not compiled.has_args:
        raise ValueError(f"args must be None for a compiled f, got {args!r}")
    if vectorized:
        raise ValueError("vectorized must be False for a compiled f, which takes one point")
    return compiled.on(frame, numbers), extra


def make_control(plan: Plan, options: Options, span: float) -> Control:
    """Return the step size control after checking its options except ``rtol``."""
    method, h, first_step = plan.method, options["h"], options["first_step"]
    rtol, atol, max_steps = options["rtol"], options["atol"], options["max_steps"]
    largest = check_step(options["max_step"], "max_step", infinite=True)
    if h is not None:
        check_unused(rtol=rtol, atol=atol, first_step=first_step, max_steps=max_steps)
        check_order(method, stacklevel=4)
        size = check_step(h, "h")
        if size > largest:
            raise ValueError(f"h must not be larger than max_step = {largest:g}, got {h!r}")
        return Control(h=size)
    if isinstance(method, Splitting):
        raise ValueError(
            f"h must be given with {method!r}: steps of splitting methods have a fixed size"
        )
    if not plan.exponent:
        raise ValueError(
            f"method must be a pair unless h gives the step size, got {options['method']!r}, "
            "which has no embedded weights"
        )
    if method.embedded_order is not None:
        check_pair(method, stacklevel=4)
    tolerances = check_atol(atol)
    if tolerances.shape not in ((), plan.tolerance_shape):
        raise ValueError(
            f"atol must be a number or have shape {plan.tolerance_shape}, got {tolerances.shape}"
        )
    first = None if first_step is None else check_step(first_step, "first_step")
    if first is not None and first > span:
        raise ValueError(f"first_step must not exceed the length of t_span, got {first_step!r}")
    assert rtol is not None
    return Control(None, rtol, tolerances, largest, first, check_max_steps(max_steps))


def _check_of_time(rhs: CompiledRhs, t: float, point: Points) -> None:
    """Raise ValueError if a compiled function reads its point."""
    nowhere = np.full_like(point, np.nan)
    if not np.array_equal(rhs.at_member(0, t, point), rhs.at_member(0, t, nowhere)):
        raise ValueError(
            "f must not read its point, since the coefficients of a linear equation depend on "
            f"time alone, got other coefficients for a point of NaN at t = {t:.17g}"
        )


def _check_force(rhs: CompiledRhs | PythonRhs, t: float, y: Points, frame: PhaseSpace) -> None:
    """Raise ValueError if a force depends on the momentum."""
    q, momentum = frame.split(y)
    more = np.sqrt(np.arange(2.0, 2.0 + frame.rhs_dim))
    other = frame.join(q, momentum + more * (1.0 + np.abs(momentum)))
    try:
        one, another = (rhs.answer(0, t, point) for point in (y, other))
    except Exception as error:
        if isinstance(rhs, PythonRhs) and not rhs.vectorized:
            error.add_note(rhs.note(t))
        raise
    if not np.array_equal(one, another):
        raise ValueError(
            "f must not depend on the momentum with a splitting method, whose kicks are not "
            f"symplectic then, got other forces for another momentum at t = {t:.17g}"
        )


def _choose_method(method: str | Method, f: Any, frame: Frame, rtol: float | None) -> Method:
    """Return the method after checking that it suits ``f`` and the frame."""
    if isinstance(method, str) and method == AUTO:
        method = choose_method(frame, rtol)
    chosen = resolve_method(method)
    if isinstance(chosen, MagnusMethod) and not isinstance(f, TimeFunction):
        raise ValueError(
            f"method must be for nonlinear equations, got {chosen!r}, which is for cg.solve_linear"
        )
    if isinstance(f, TimeFunction) and isinstance(frame, PhaseSpace):
        raise ValueError(
            f"frame must not be a phase space, got {frame!r}, whose velocities depend on the point"
        )
    if isinstance(chosen, Splitting) and not isinstance(frame, PhaseSpace):
        raise ValueError(
            f"frame must be a cg.frames.PhaseSpace with {chosen!r}, which splits the equations of "
            f"mechanical systems, got {frame!r}"
        )
    if isinstance(chosen, MuntheKaas) and not has_brackets(frame):
        check_algebra(frame, chosen, linear=isinstance(f, TimeFunction))
    return chosen


def make_problem(
    f: Any,
    t_span: Any,
    y0: ArrayLike,
    *,
    frame: Any,
    options: StepOptions,
    many: bool = False,
    vectorized: bool = False,
    common: bool = False,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    jac: Any = None,
) -> Problem:
    """Check the arguments of `cg.solve_ivp` or, if ``many``, of `cg.solve_ensemble`."""
    given, adaptive = complete_options(options), options.get("h") is None
    if not isinstance(frame, Frame):
        raise TypeError(f"frame must be a Frame such as SO3(), got {frame!r}")
    check_stage_solver(stage_solver)
    if adaptive:
        given["rtol"] = check_rtol(given["rtol"])
    chosen = _choose_method(given["method"], f, frame, given["rtol"] if adaptive else None)
    plan = plan_of(frame, chosen)
    points, numbers = check_points(plan, y0, given["parameters"], many)
    plan.detect_coordinates(points[0])
    rhs, extra = make_rhs(f, frame, given["args"], numbers, vectorized, len(points))
    start, stop = check_span(t_span)
    if isinstance(chosen, Splitting):
        _check_force(rhs, start, points[0], cast(PhaseSpace, frame))
    jacobian = None
    if jac is not None:
        jacobian = jacobian_of(jac, f, frame, chosen, rhs, start, points[0])
    if isinstance(f, TimeFunction) and isinstance(rhs, CompiledRhs):
        _check_of_time(rhs, start, points[0])
    stops = check_stops(given["breakpoints"], start, stop)
    control = make_control(plan, given, abs(stop - start))
    t_eval = given["t_eval"]
    problem = Problem(
        plan, rhs, points, start, stops, control, f, given["events"], extra,
        None if t_eval is None else check_t_eval(t_eval, start, stop),
        check_flag("dense_output", given["dense_output"]), stage_solver, common, jacobian,
    )  # fmt: skip
    if problem.events is not None:
        problem.event_table()
    return problem
