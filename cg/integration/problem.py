"""The problem of an integration: its arguments after checking."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame, check_frame
from cg.frames.facts import check_brackets, frames_for_derivatives
from cg.frames.linear_action import LinearAction
from cg.frames.phase_space import PhaseSpace
from cg.integration import arguments
from cg.integration.arguments import DEFAULT_ATOL, DEFAULT_RTOL
from cg.integration.default_method import AUTO, choose_method
from cg.integration.heat_bath import Langevin
from cg.integration.mechanics import (
    MemberInertia,
    check_thermostat,
    read_member_inertia,
    refuse_friction,
    step_function_of,
)
from cg.integration.options import EnsembleOptions
from cg.integration.output.solutions import EnsembleSolution, Solution
from cg.integration.plan.plan import Plan, plan_of
from cg.integration.rhs.compiled import compiled_rhs
from cg.integration.rhs.events import EventTable, Observer, observer_of
from cg.integration.rhs.function import TimeFunction
from cg.integration.rhs.inputs import (
    ExtraArguments,
    Inputs,
    WithInput,
    check_abscissae,
    check_inputs,
    check_member_inputs,
)
from cg.integration.rhs.python import Jacobian, PythonRhs, Rhs, jacobian_of
from cg.support.arrays import Array, Points, read_only
from cg.support.checks import (
    NO_LIMIT,
    check_choice,
    check_count,
    check_real,
    short,
    texts_of,
    warn_user,
)
from cg.support.frozen import changed
from cg.tables import Kind, MethodTable, table_of

_FUNCTIONS = "jac", "events", "observe", "step_function", "df_dp", "noise"
DERIVATIVE_OPTIONS = "df_dp", "derivatives_by", "P0", "noise", "control_derivatives"


class Control(NamedTuple):
    """The step size control; by default that of equal steps.

    Equal steps have tolerances too, by which a collocation method scales Newton's corrections.
    """

    h: float | None  # size of equal steps, None for adaptive steps
    rtol: Array = DEFAULT_RTOL  # has the shape of atol
    atol: Array = DEFAULT_ATOL
    max_step: float = math.inf
    first_step: float | None = None
    max_steps: int = arguments.DEFAULT_MAX_STEPS

    @property
    def tolerance(self) -> float | None:
        """The smallest relative tolerance, None for equal steps."""
        return None if self.h is not None else float(self.rtol.min())


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """An integration of one point or of the members of an ensemble."""

    # the equation
    plan: Plan
    in_coordinates: bool  # whether differences of points are in coordinates, not in entries
    rhs: Rhs
    linear: bool  # whether the right-hand side depends on time alone
    jacobian: Jacobian | None  # for Newton's method, None for differences
    events: EventTable | None
    # members
    points: Points  # initial points, shape (members, *point_shape)
    ensemble: bool  # whether it has members, even one
    common_steps: bool  # whether all members take the same steps
    first_member: int = 0  # number of the first of these members in the ensemble
    inertia: MemberInertia | None = None  # None if all members have the inertia of the frame
    # inputs of each member, if each has its own sample times; `of_members` adds their corners
    member_inputs: tuple[Inputs, ...] = ()
    # times and steps
    t0: float
    direction: float  # 1.0 forward in time, -1.0 backward, also where the span is empty
    segment_ends: Array  # breakpoints, then the final time
    limits: Array  # rows (t, limit): steps from t to the next row are at most limit long
    control: Control
    stage_solver: str
    step_function: Observer | None = None  # how steps vary, None for equal or adaptive ones
    thermostat: Langevin | None = None
    # output
    t_eval: Array | None
    every: int  # number of steps between stored steps, 0 to store none
    dense_output: bool  # whether to store interpolants
    observer: Observer | None
    # splits points that hold derivatives into the points and derivatives of a solution
    split_solution: Callable[[Problem, EnsembleSolution], EnsembleSolution] | None = None
    with_gradients: Callable[[Solution], Solution] | None = None  # adds gradients by the adjoint

    @property
    def one_by_one(self) -> bool:
        """Whether each member has a problem of its own."""
        return bool(self.member_inputs) or (self.inertia is not None and self.inertia.one_by_one)

    @property
    def vectorized(self) -> bool:
        """Whether a function takes many members at a time."""
        events = self.events
        return self.rhs.vectorized or bool(events and events.rows["vectorized"].any())

    @property
    def keeps_points(self) -> bool:
        """Whether points are stored at output times."""
        return self.observer is None or self.observer.keeps_points

    @property
    def t1(self) -> float:
        """Final time."""
        return float(self.segment_ends[-1])

    def of_members(self, members: slice) -> Problem:
        """Return the problem of some members."""
        if members == slice(0, len(self.points)) and not self.one_by_one:
            return self
        first, plan, events, extra = members.start, self.plan, self.events, self.rhs.extra
        ends, limits = self.segment_ends, self.limits
        inputs, parameters = extra.inputs, extra.parameters
        inertia = self.inertia and self.inertia.of_members(members)
        if self.member_inputs:
            inputs = self.member_inputs[first]
            tolerance = self.control.tolerance
            ends, limits = inputs.add_corners(ends, self.t0, tolerance), inputs.limits(tolerance)
        elif inputs is not None:
            inputs = inputs.of_members(members)
        parameters = None if parameters is None else parameters[members]
        extra = extra._replace(parameters=parameters, inputs=inputs, first_member=first)
        rhs = self.rhs.with_data(extra)
        if inertia is not None and inertia.one_by_one:
            plan, inertia = inertia.plan(0, plan), None
            rhs, events = rhs.on_form(plan.form), events and events.on_frame(plan.frame)
        return changed(
            self, plan=plan, points=self.points[members], rhs=rhs, events=events,
            first_member=first, inertia=inertia, segment_ends=ends, limits=limits,
            member_inputs=(), split_solution=None,
        )  # fmt: skip

    def arguments(self, member: int) -> tuple[Any, ...]:
        """Return the arguments of a member's functions after time and point."""
        if not self.member_inputs:
            return self.rhs.extra.arguments(member)
        return self.of_members(slice(member, member + 1)).rhs.extra.arguments(0)


def _make_rhs(
    f: Any, plan: Plan, options: EnsembleOptions, parameters: Array | None, inputs: Inputs | None,
    ensemble: bool,
) -> Rhs:  # fmt: skip
    """Return the right-hand side after checking ``f`` and args."""
    args = arguments.check_args(options["args"])
    extra = ExtraArguments(args, parameters, inputs, first_member=0 if ensemble else None)
    linear = options["linear"]
    compiled = None if isinstance(f, FunctionType) else compiled_rhs(f)
    if compiled is None:
        if not callable(f):
            raise TypeError(f"f must be callable as f(t{', y' * (not linear)}), got {f!r}")
        if linear:
            f = TimeFunction(f)
        if inputs is not None:
            f = WithInput(f)
        return PythonRhs(f, plan.form, extra, options["vectorized"])
    if options["vectorized"]:
        argument = "time" if linear else "point"
        raise ValueError(f"vectorized must be False for a compiled f, which takes one {argument}")
    return compiled.on_form(plan.form).with_data(extra)


def _make_control(
    plan: Plan, in_coordinates: bool, rtol: Array, options: EnsembleOptions, span: float
) -> Control:
    """Return the step size control after checking its options; ``rtol`` has been checked."""
    max_step = check_real("max_step", options["max_step"], positive=True, infinite=True)
    max_steps, first_step = arguments.DEFAULT_MAX_STEPS, options["first_step"]
    if options["max_steps"] is not None:
        max_steps = check_count("max_steps", options["max_steps"])
    if options["h"] is not None:
        return _equal_steps(plan, options, span, max_step, max_steps)
    _check_pair(plan, options)
    rtol, atol = _read_tolerances(plan, in_coordinates, rtol, options)
    if first_step is not None:
        first_step = check_real("first_step", first_step, positive=True)
    if first_step is not None and first_step > span:
        raise ValueError(f"first_step must not exceed the length of t_span, got {first_step!r}")
    return Control(None, rtol, atol, max_step, first_step, max_steps)


def _equal_steps(
    plan: Plan, options: EnsembleOptions, span: float, max_step: float, max_steps: int
) -> Control:
    """Return the control of steps of one size, or of sizes that a ``step_function`` varies."""
    varies = options["step_function"] is not None
    for name in ("rtol", "atol", "first_step", "max_steps"):
        if options[name] is not None and not (varies and name == "max_steps"):
            raise ValueError(f"{name} must not be given together with h, got {options[name]!r}")
    _warn(plan.table, pair=False)
    size = check_real("h", options["h"], positive=True)
    if math.isinf(span):
        raise ValueError("t_span must be finite with h, got an infinite end")
    if size > max_step:
        largest, got = texts_of(max_step, size)
        raise ValueError(f"h must not be larger than max_step = {largest}, got {got}")
    return Control(h=size, max_steps=max_steps if varies else NO_LIMIT)


def _check_pair(plan: Plan, options: EnsembleOptions) -> None:
    """Raise ValueError unless the method estimates errors, by which steps are chosen."""
    if plan.table.kind is Kind.SPLITTING:
        raise ValueError(
            f"h must be given with {plan.table!r}, since steps of splitting methods have a fixed "
            "size, got None"
        )
    if not plan.step_table.exponent:
        raise ValueError(
            f"method must be a pair unless h gives the step size, got {options['method']!r}, "
            "which has no embedded weights"
        )
    # a step by one flow along a polynomial has another error estimate than the method
    _warn(plan.table, pair=plan.step_table is plan.table)


def _read_tolerances(
    plan: Plan, in_coordinates: bool, rtol: Array, options: EnsembleOptions
) -> tuple[Array, Array]:
    """Return relative and absolute tolerances of one shape after checking their shapes."""
    shape = (plan.dim,) if in_coordinates else plan.point_shape
    atol = DEFAULT_ATOL
    if options["atol"] is not None:
        atol = arguments.check_tolerances("atol", options["atol"])
    if rtol.ndim == atol.ndim == 0:
        return rtol, atol
    for name, tolerance in (("rtol", rtol), ("atol", atol)):
        if tolerance.shape not in ((), shape):
            unit = "coordinate" if in_coordinates else "entry"
            raise ValueError(
                f"{name} must be a number or have shape {shape}, one number a {unit}, "
                f"got {tolerance.shape}"
            )
    return np.full(shape, rtol), np.full(shape, atol)


def _warn(table: MethodTable, pair: bool) -> None:
    """Warn if solutions don't converge, or the error estimate of a ``pair`` is unreliable."""
    name = table.name or "the method"
    if not table.converges:
        warn_user(f"{name} has order 0: its solutions don't converge")
    if pair and table.estimate_fault:
        warn_user(f"{name}: {table.estimate_fault}")


def _check_rhs(
    plan: Plan, rhs: Rhs, linear: bool, start: float, end: float, points: Points
) -> None:
    """Raise ValueError if forces are friction, or f of a ``linear`` equation reads its point.

    ``points`` are the initial points, at which forces at the final time are compared too.
    """
    if plan.table.kind is Kind.SPLITTING:
        for time in {start, end}:  # a friction may vanish at the start
            if math.isfinite(time):
                refuse_friction(plan, rhs, [time], points[None])
    if not linear or isinstance(rhs, PythonRhs):
        return
    point, nowhere = points[0], np.full_like(points[0], np.nan)
    values = rhs.at_member(0, start, point), rhs.at_member(0, start, nowhere)
    if not np.array_equal(*values, equal_nan=True):
        raise ValueError(
            "f must not read its point with linear=True, since its coefficients depend on time "
            f"alone then, got others for a point of NaN at t = {start:.17g}"
        )


def _checked_method(
    chosen: MethodTable | None, linear: bool, frame: Frame, rtol: float | None, stage_solver: str
) -> MethodTable:
    """Return the chosen or the default method after checking the equation and the frame."""
    if linear and isinstance(frame, PhaseSpace):
        raise ValueError(
            "frame must not be a phase space with linear=True, since velocities depend on the "
            f"point, got {frame!r}"
        )
    if frame.jointed and not isinstance(frame, PhaseSpace):
        raise ValueError(
            "frame must not have a phase space with joints as a factor, whose forces would be "
            f"missing; take cg.frames.PhaseSpace of a product with all joints, got {frame!r}"
        )
    if chosen is None:
        return table_of(choose_method(frame, rtol, linear))
    if chosen.kind is Kind.COLLOCATION and stage_solver != "newton":
        raise ValueError(f"stage_solver must be 'newton' with {chosen!r}, got {stage_solver!r}")
    if chosen.kind is Kind.LINEAR and not linear:
        raise ValueError(
            f"method must be for nonlinear equations, got {chosen!r}, which is for linear=True"
        )
    if chosen.kind is Kind.SPLITTING:
        if not isinstance(frame, PhaseSpace):
            raise ValueError(
                f"frame must be a cg.frames.PhaseSpace with {chosen!r}, which splits the equations "
                f"of mechanical systems, got {frame!r}"
            )
        if frame.jointed and not chosen.composes_leapfrogs:
            raise ValueError(
                f"method must be 'RATTLE' or a composition of it, such as 'RATTLE4', on a phase "
                f"space with joints, got {chosen!r}: its kicks and drifts are separate flows, and "
                "a drift between joints is none that is known exactly"
            )
    one_flow = isinstance(frame, LinearAction) and chosen.polynomial is not None
    if chosen.on_algebra or (chosen.has_brackets and not one_flow):
        check_brackets(frame, chosen)
    return chosen


def _count_members(inputs: Any) -> int:
    """Return the number of members that unchecked inputs are for, by default one."""
    if isinstance(inputs, list):
        return max(len(inputs), 1)
    curves = inputs if isinstance(inputs, tuple) else (inputs,)
    return next((n for c in curves if (n := getattr(c, "members", None)) is not None), 1)


def _returns_derivatives(rhs: str, linear: bool, frame: Frame) -> bool:
    """Return whether ``f`` returns derivatives of points, after checking that it may."""
    check_choice("rhs", rhs, ("coefficients", "derivative"))
    if rhs == "derivative" and linear:
        raise ValueError("rhs must be 'coefficients' with linear=True, got 'derivative'")
    if rhs == "derivative" and isinstance(frame, PhaseSpace):
        raise ValueError(
            f"rhs must be 'coefficients' on a phase space, where f returns the forces alone, got "
            f"{rhs!r}; the product of its factors takes derivatives"
        )
    return rhs == "derivative"


def _make_plan(frame: Any, options: EnsembleOptions) -> tuple[Plan, Array]:
    """Return the plan of the frame and the method, and ``rtol``, after checking all three."""
    check_frame(frame)
    rtol, min_rtol, user_frame = DEFAULT_RTOL, None, None
    if options["h"] is None:
        if options["rtol"] is not None:
            rtol = arguments.check_rtol(options["rtol"])
        min_rtol = float(rtol.min())
    method: Any = options["method"]
    chosen = None if isinstance(method, str) and method == AUTO else table_of(method)
    if _returns_derivatives(options["rhs"], options["linear"], frame):
        brackets = chosen is not None and (chosen.on_algebra or chosen.has_brackets)
        user_frame, fastest = frames_for_derivatives(frame)
        frame = user_frame if brackets or options["derivatives"] is not None else fastest
    linear, solver = options["linear"], options["stage_solver"]
    table = _checked_method(chosen, linear, frame, min_rtol, solver)
    return plan_of(frame, table, user_frame), rtol


def _check_choices(options: EnsembleOptions, ensemble: bool) -> None:
    """Check options that are choices, and refuse contradictions between them and flags."""
    linear, derivatives = options["linear"], options["derivatives"]
    check_choice("stage_solver", options["stage_solver"], arguments.STAGE_SOLVERS)
    if not ensemble and options["common_steps"]:
        raise ValueError("common_steps must be False for a single point")
    if not ensemble and options["vectorized"] and not linear:
        raise ValueError("vectorized must be False for a single point, unless linear=True")
    if linear and options["jac"] is not None:
        raise ValueError(f"jac must be None with linear=True, got {options['jac']!r}")
    refused: tuple[str, ...] = DERIVATIVE_OPTIONS
    if derivatives is not None:
        allowed = ["forward"] * (not linear) + ["adjoint"] * (not ensemble)
        if not isinstance(derivatives, str) or derivatives not in allowed:
            names = " or ".join(map(repr, [None, *allowed]))
            where = " with linear=True" * linear + " for an ensemble" * ensemble
            raise ValueError(f"derivatives must be {names}{where}, got {derivatives!r}")
        refused = DERIVATIVE_OPTIONS[1:] if derivatives == "adjoint" else ()
    given: Any = options
    for name in refused:
        value = given[name]
        if value is not None and value is not False:
            needed = "'forward'" + " or 'adjoint'" * (name == "df_dp")
            raise ValueError(f"derivatives must be {needed} with {name}, got {derivatives!r}")


def _read_members(
    plan: Plan, options: EnsembleOptions, y0: ArrayLike, ensemble: bool
) -> tuple[Points, Array | None, MemberInertia | None]:
    """Return initial points, parameters and inertia of the members after checking them."""
    frame, inputs, inertia = plan.frame, options["inputs"], None
    if options["inertia"] is not None and frame.jointed:
        return _read_jointed_members(plan, options, y0)
    points, parameters = arguments.read_initial_members(plan, y0, options["parameters"], ensemble)
    if frame.jointed and isinstance(frame, PhaseSpace):
        frame.check_rank(points[0], "y0")
    members = len(points)
    if ensemble and members == 1 and inputs is not None:
        members = _count_members(inputs)
    if options["inertia"] is not None:
        inertia = read_member_inertia(options["inertia"], frame, options, members)
        members = len(inertia.signed_columns)
    if members > len(points):  # a single point serves all of them
        points = np.repeat(points, members, axis=0)
        if parameters is not None:
            parameters = read_only(np.repeat(parameters, members, axis=0))
    return points, parameters, inertia


def _read_jointed_members(
    plan: Plan, options: EnsembleOptions, y0: ArrayLike
) -> tuple[Points, Array | None, MemberInertia]:
    """Return points, parameters and inertia of members with joints.

    Joints constrain velocities, so that the inertia of a member decides which momenta it may have.
    """
    starts = np.atleast_2d(plan.frame._points(arguments.read_points(plan.frame, y0), "y0"))
    if starts.ndim > 2:
        raise ValueError(f"y0 must have at most one axis of members, got shape {starts.shape}")
    inertia = read_member_inertia(options["inertia"], plan.frame, options, len(starts))
    members = len(inertia.signed_columns)
    points = []
    for k, y in enumerate(np.broadcast_to(starts, (members, *plan.point_shape))):
        member_plan: Any = inertia.plan(k, plan)
        name = f"y0[{k}]" if len(starts) > 1 else "y0"
        points.append(arguments.read_starts(member_plan, y, False, name)[0])
        member_plan.frame.check_rank(points[-1], name)
    repeated, parameters = arguments.read_initial_members(
        inertia.plan(0, plan), np.array([points[0]] * members), options["parameters"], True
    )
    if len(repeated) != members:
        raise ValueError(
            f"inertia must have {len(repeated)} entries, one for each member, got {members}"
        )
    return np.array(points), parameters, inertia


def _read_inputs(
    plan: Plan, options: EnsembleOptions, start: float, end: float, members: int | None
) -> tuple[Inputs | None, tuple[Inputs, ...]]:
    """Return the inputs, and the inputs of each member where members have their own times."""
    inputs: Any = options["inputs"]
    name = "the initial time" if start == end else "t_span"
    if members is None or not isinstance(inputs, list):
        return check_inputs(inputs, start, end, members, plan.table, name), ()
    if options["common_steps"]:
        raise ValueError("common_steps must be False with a list of inputs, of each member")
    member_inputs = check_member_inputs(inputs, start, end, members, plan.table, name)
    return member_inputs[0], member_inputs


def _read_times(
    plan: Plan, options: EnsembleOptions, start: float, end: float, ensemble: bool
) -> tuple[Array, Array | None]:
    """Return the breakpoints with the final time, and the output times, None for ends of steps."""
    segment_ends = arguments.check_breakpoints(options["breakpoints"], start, end)
    if len(segment_ends) > 1:
        check_abscissae(plan.table, "breakpoints")
    if options["t_eval"] is not None:
        t_eval = arguments.check_times("t_eval", options["t_eval"], "within t_span,", start, end)
        if options["thermostat"] is not None:  # points between steps would have no noise
            segment_ends = np.union1d(segment_ends, t_eval[t_eval != start])
        return segment_ends, t_eval
    if not ensemble:
        return segment_ends, None
    return segment_ends, np.array([start, end][: 1 + (start != end and math.isfinite(end))])


def _read_events(
    options: EnsembleOptions, frame: Frame, rhs: Rhs, start: float, end: float
) -> EventTable | None:
    """Return the events after checking that they fit the span and the steps."""
    events = None
    if options["events"] is not None:
        events = EventTable(
            options["events"], frame, inputs=rhs.extra.inputs is not None,
            parameters=rhs.extra.parameters is not None, in_python=isinstance(rhs, PythonRhs),
        )  # fmt: skip
        if options["common_steps"] and events.rows["jumps"].any():
            raise ValueError("events must have no jumps with common_steps, which all members share")
    if math.isinf(end) and not (events and events.has_terminal):
        raise ValueError(
            f"events must hold a terminal one if t_span has no end, {(start, end)!r}, got "
            f"{short(options['events'])}"
        )
    return events


def _check_picklable(f: Any, frame: Frame, rhs: Rhs, options: Any) -> None:
    """Raise ValueError if an argument can't be sent to the processes that are asked for."""
    executor = options["executor"]
    if executor != "processes" and not isinstance(executor, ProcessPoolExecutor):
        return
    sent = {name: options[name] for name in _FUNCTIONS}
    for name, value in {"f": f, "frame": frame, "args": rhs.extra.args, **sent}.items():
        try:
            pickle.dumps(value)
        except Exception as error:
            raise ValueError(
                f"{name} must be picklable for other processes, got {short(value)}; a "
                "cg.CompiledFunction or a function of a module is"
            ) from error


def make_problem(
    f: Any, t_span: Any, y0: ArrayLike, frame: Any, options: EnsembleOptions, *,
    ensemble: bool = False, every: int = 1, bound: float | None = None,
) -> Problem:  # fmt: skip
    """Check the arguments of `cg.solve_ivp` or, for an ``ensemble``, of `cg.solve_ensemble`.

    A `cg.Stepper` gives its ``bound``, toward which it goes from an empty span.

    The order matters, since each step reads the results of those before: flags decide what other
    options may be, the frame and the method how points are read, points and inputs how many
    members there are, and all of these make the right-hand side. Functions of the user are called
    from `_check_rhs` on, after what can be checked without calls.
    """
    _check_choices(options, ensemble)
    plan, rtol = _make_plan(frame, options)
    frame = plan.frame
    points, parameters, inertia = _read_members(plan, options, y0, ensemble)
    start, end = arguments.check_span(t_span)
    bound = end if bound is None else bound
    if options["thermostat"] is not None:
        check_thermostat(options["thermostat"], start, bound, plan.table, options)
    members = len(points) if ensemble else None
    inputs, member_inputs = _read_inputs(plan, options, start, end, members)
    rhs = _make_rhs(f, plan, options, parameters, inputs, ensemble)
    if ensemble:
        _check_picklable(f, plan.user_frame, rhs, options)
    _check_rhs(plan, rhs, options["linear"], start, end, points)
    jacobian = None
    if options["jac"] is not None and options["derivatives"] is None:
        jacobian = jacobian_of(options["jac"], frame, plan.table, rhs, start, points[0])
    segment_ends, t_eval = _read_times(plan, options, start, end, ensemble)
    in_coordinates = plan.in_coordinates(points[0])
    control = _make_control(plan, in_coordinates, rtol, options, abs(end - start))
    limits = np.empty((0, 2))
    if inputs is not None and not member_inputs:
        segment_ends = inputs.add_corners(segment_ends, start, control.tolerance)
        limits = inputs.limits(control.tolerance)
    events = _read_events(options, frame, rhs, start, end)
    step_function = step_function_of(options, plan, rhs, start, bound, points[0])
    observer = observer_of(options["observe"], options["store"], frame, rhs, start, points[0])
    return Problem(
        plan=plan, in_coordinates=in_coordinates, rhs=rhs, points=points,
        t0=start, direction=-1.0 if bound < start else 1.0, segment_ends=segment_ends,
        limits=limits, control=control, events=events,
        t_eval=t_eval, every=every if t_eval is None else 0,
        dense_output=options["dense_output"], stage_solver=options["stage_solver"],
        ensemble=ensemble, common_steps=options["common_steps"],
        linear=options["linear"], jacobian=jacobian, observer=observer,
        member_inputs=member_inputs, thermostat=options["thermostat"],
        inertia=inertia, step_function=step_function,
    )  # fmt: skip
