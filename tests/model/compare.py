"""Runs of a program, compared with the model and with each other.

Each run is a text that is executed behind the program's script. `Difference` contains this text,
so that both together show what differs.
"""

import concurrent.futures
import multiprocessing
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

import cg
from tests.model import scripts
from tests.model.drawing import SPLITTINGS
from tests.model.programs import Program
from tests.model.reference import Path, covariance, difference, growth, solve, value_of
from tests.model.scripts import CALL
from tests.model.spaces import reals

TOLERANCES = 50  # admitted, times the growth of errors
EPS = float(np.finfo(float).eps)
EVENTS, COUNTS = ("t_events", "y_events", "y_after"), ("steps", "nrejected")
NO_BOUND = "derivatives with fixed steps have no bound"
DERIVATIVES = ("transition", "sensitivity", "covariance")
EVALUATIONS = ("nfev", "nexp", "njev", "nlu")


class Difference(AssertionError):
    """What differs, of which kind, and the lines that show it behind the script of the program."""

    def __init__(self, kind: str, text: str, code: str = ""):
        super().__init__(text)
        self.kind, self.code = kind, code


class Unclear(Exception):
    """The program has no definite answer: it depends on errors smaller than the tolerances."""


@dataclass
class Case:
    """A program, the names of its script, and its solutions: the model's, and that of `CALL`."""

    program: Program
    names: dict[str, Any]
    path: Path
    bound: float = 0.0  # largest distance of points
    solution: Any = None

    def run(self, code: str) -> dict[str, Any]:
        """Run a text behind the script; return all names."""
        names = dict(self.names)
        try:
            exec(code, names)
        except ModuleNotFoundError as error:  # JAX is an extra
            raise Unclear(str(error)) from error
        except Exception as error:
            if isinstance(error, cg.StepTooLongError | cg.ConvergenceError) and self.program.steps:
                raise Unclear("steps are too long for the method") from error
            name = type(error).__name__
            raise Difference(name, f"raised {name}: {error}", code) from error
        return names

    def solve(self, code: str = CALL, **changed: Any) -> Any:
        if changed:
            code = code.replace("**options", f"**{{**options, **{changed}}}")
        return self.run(code)["s"]

    @property
    def length(self) -> float:
        return abs(self.path.end - self.path.task.span[0]) or 1.0

    def grid(self, n: int = 23) -> Sequence[float]:
        return np.linspace(self.path.task.span[0], self.path.end, n)

    def grown(self) -> float:
        """Return the bound of points times the growth of errors, which is computed when needed."""
        factor = growth(self.path, list(self.grid()))
        if factor > 1e4:  # which makes one half of 50 tolerances of 1e-6
            raise Unclear("errors grow too much")
        return factor * self.bound

    def near_jump(self, t: float) -> bool:
        # the times of jumps have errors, and points between these times are off by the jump
        return any(abs(t - jump) < 1e-2 * self.length for jump in self.path.jumps)

    def jumps(self) -> bool:
        return any(zero.jump for zero in self.program.events)


def check(program: Program) -> str:
    """Compare a program with the model; return "compared", or why there is no answer."""
    try:
        names = program.build()
        case = Case(program, names, solve(program.task(names)))
    except ArithmeticError:
        return "the model has no solution"
    except ModuleNotFoundError as error:  # numba is an extra
        return str(error)
    if program.endless and not case.path.terminated:
        return "no event ends it"
    outcome = "compared"
    with warnings.catch_warnings():
        warnings.simplefilter("error" if not program.steps else "ignore")
        # stages beyond the domain of f; what is normal to a sphere by rounding
        warnings.filterwarnings("ignore", "invalid value encountered in sqrt")
        warnings.filterwarnings("ignore", "f returns derivatives with a part")
        try:
            case.solution, case.bound = case.solve(), _bound(case)
        except Unclear as reason:
            return str(reason)
        callers = [CALLERS[name] for name in program.callers]
        for compare in (*ALWAYS, *callers):
            try:
                compare(case)
            except Unclear as reason:
                outcome = str(reason)
    return outcome


def _bound(case: Case) -> float:
    """Return 50 tolerances; or with fixed steps five times the changes with shorter ones.

    These must become smaller as in a method of order one, or the steps are too long for a bound.
    Steps end at breakpoints and samples, so that shorter ones are shorter than what is between.
    """
    program = case.program
    size = max([1.0, *(float(np.abs(case.path(t)).max()) for t in case.grid())])
    floor = 1e-9 * size
    if not program.steps:
        return TOLERANCES * (program.atol + program.rtol * size) + floor
    ends = [float(t) for t in case.grid()[:-1]]
    task, h = case.path.task, case.names["options"]["h"]
    gaps = np.diff(np.unique([task.span[0], *task.breakpoints, *task.knots, case.path.end]))
    short = min([h, *gaps[gaps > 1e-3 * case.length]])
    try:
        runs = [case.solve(h=float(size), t_eval=ends) for size in (h, short / 4, short / 16)]
    except Unclear:
        return np.inf
    first, second = (_change(case, *pair) for pair in pairwise(runs))
    return 5 * max(first, second) + floor if second < 0.4 * first + floor else np.inf


def _change(case: Case, coarse: Any, fine: Any) -> float:
    """Return by how much points and events of two solutions differ."""
    if len(fine.t) != len(coarse.t):
        return np.inf
    changes = [float(np.abs(fine.y - coarse.y).max())]
    for k, (near, far) in enumerate(zip(fine.t_events or (), coarse.t_events or (), strict=True)):
        if len(near) != len(far):
            return np.inf
        changes += [*(np.abs(near - far) * max([1.0, *case.path.slopes[k]]))]
        changes += [float(np.abs(fine.y_events[k] - coarse.y_events[k]).max(initial=0.0))]
    return max(changes)


# Comparisons with the model


def accurate(case: Case, s: Any, code: str) -> None:
    """Raise unless a solution is that of the model, within the bound."""
    for name, array in vars(s).items():
        if isinstance(array, np.ndarray) and not np.isfinite(array).all():
            raise Difference(name, f"{name} is not finite", f"{code}\nprint(s.{name})")
    if np.isinf(case.bound):
        raise Unclear("steps are too long")
    _reached(case, s, code)
    between = case.program.method != "RadauIIA5"  # whose output between steps errs by O(h⁴)
    if between or case.program.output is None:
        _near(case, s.t, s.y, f"{code}\nprint(s.t, s.y)")
    if s.sol is not None and between:
        grid = np.clip(case.grid(), s.sol.t_min, s.sol.t_max)
        _near(case, grid, s.sol(grid), f"{code}\nprint(s.sol({grid.tolist()}))")
    if case.program.events and between:
        _events(case, s, code)


def _reached(case: Case, s: Any, code: str) -> None:
    """Raise unless the status is that of the model, and times are those asked for."""
    program, path, times = case.program, case.path, s.t.tolist()
    slopes = sorted(slope for slopes in path.slopes for slope in slopes)
    if "leaves its function at zero" in s.message and slopes[0] < 0.1 * slopes[-1]:
        # rounding decides which of them is the last
        raise Unclear("jumps come ever faster")
    if not s.success and _singular(case):
        raise Unclear("points are nearly singular matrices, without accurate coordinates")
    if s.success and s.status != int(path.terminated):
        _doubt(case)
    expected = program.times((0.0, 1.0) if program.output is None else program.output)
    reached = times if program.output is not None else [times[0], times[-1]]
    all_times = path.terminated or program.length == 0 or reached == expected
    for kind, is_right, text in (
        ("success", s.success, s.message),
        ("status", s.status == int(path.terminated), f"{s.message} The model: {path.terminated=}"),
        ("order", np.all(np.diff(s.t) * np.sign(program.length) > 0), "times aren't in order"),
        ("times", all_times, f"{reached} not {expected}"),
    ):
        if not is_right:
            raise Difference(kind, text, f"{code}\nprint(s)")


def _singular(case: Case) -> bool:
    """Whether rounding changes coordinates of a point of a matrix group by a tolerance."""
    base = case.program.frame.base
    if base.ndim != 2 or base.shape[0] != base.shape[1]:
        return False
    points = [case.path(t).view(base.dtype).reshape(base.shape) for t in case.grid()]
    return EPS * max(map(np.linalg.cond, points)) > 0.1 * case.program.rtol


def _near(case: Case, times: Sequence[float], values: Any, code: str) -> None:
    """Raise unless points are those of the model; near jumps none counts."""
    path, worst = case.path, (0.0, 0.0, np.zeros(0))
    for t, value in zip(map(float, times), values, strict=True):
        if case.near_jump(t):
            continue
        beyond = path.terminated and (t - path.end) * np.sign(case.program.length) > 0
        expected = path(path.end if beyond else t)
        error = float(np.abs(reals(value) - expected).max())
        worst = max(worst, (error, t, expected), key=lambda entry: entry[0])
    error, t, expected = worst
    if error <= case.bound:
        return
    _doubt(case)
    if error > (bound := case.grown()):
        text = f"at t = {t!r} off by {error:.2e}, bound {bound:.2e}; the model has "
        raise Difference("point", text + str(expected.tolist()), code)


def _events(case: Case, s: Any, code: str) -> None:
    path = case.path
    expected = [[t for t, *_ in events] for events in path.events]
    if [len(times) for times in s.t_events] != [len(times) for times in expected]:
        _doubt(case)
        raise Difference("events", f"events {s.t_events}, of the model {expected}", code)
    for k, model in enumerate(path.events):
        for i, (exact, _, behind, jumps) in enumerate(model):
            t, before, after = (getattr(s, name)[k][i] for name in EVENTS)
            if not np.array_equal(reals(after), behind if jumps else reals(before)):
                text = f"y_after[{k}][{i}] isn't what the jump returns"
                raise Difference("jump", text, code)
            slope = path.slopes[k][i]
            rounding = 1e-9 * case.length + 8 * np.spacing(abs(exact))
            if abs(t - exact) <= case.bound / slope + rounding:
                continue
            _doubt(case)
            if abs(t - exact) > case.grown() / slope + rounding:
                raise Difference(
                    "time of an event",
                    f"event {k}, {i} at {t!r}, of the model {exact!r}",
                    f"{code}\nprint(s.t_events[{k}][{i}], 'is not', {exact!r})",
                )


def _doubt(case: Case) -> None:
    """Raise Unclear where events of the model depend on errors within the tolerance."""
    if not case.program.events:
        return
    bound, path, task = case.grown(), case.path, case.path.task
    for k, nearest in enumerate(path.nearest):
        if nearest < 2 * bound:
            raise Unclear(f"event {k} is nearly missed")
        if min(path.slopes[k], default=np.inf) * case.length * 0.05 < bound:
            raise Unclear(f"event {k} is slow")
        begin, end = (
            abs(value_of(task, task.events[k], t, path(t))) for t in (task.span[0], path.end)
        )
        least = -1.0 if case.program.derivatives else 1e-9  # is zero for other points
        if least < begin < 2 * bound or (end < 2 * bound and not path.terminated):
            raise Unclear(f"event {k} is at an end")
    times = sorted(t for events in path.events for t, *_ in events)
    stops = (*task.breakpoints, *task.knots)
    if path.jumps and any(0 < abs(t - p) < 1e-9 * case.length for t in times for p in stops):
        raise Unclear("an event is nearly at a stop")
    slope = min((slope for slopes in path.slopes for slope in slopes), default=1.0)
    copied = (path.jumps or path.terminated) and any(e.kind == "copy" for e in case.program.events)
    if copied and any(16 * EPS * abs(t) * min(slope, 1.0) < 1e-10 or t in stops for t in times):
        raise Unclear("events are 1e-10 apart, more than the resolution of time, or at a stop")
    gap = 2 * bound / slope
    if path.jumps and any(1e-9 * case.length < b - a < gap for a, b in pairwise(times)):
        raise Unclear("events come in an order that depends on errors")


# Comparisons of runs with each other


def same(ours: Any, theirs: Any, names: Sequence[str], code: str) -> None:
    """Raise unless attributes are equal to the bit."""
    for name in names:
        pair = [getattr(solution, name) for solution in (ours, theirs)]
        a, b = (value if isinstance(value, list) else [value] for value in pair)
        if len(a) != len(b) or not all(map(np.array_equal, a, b)):
            lines = f"{CALL}\nprint(s.{name})\n{code}\nprint(s.{name})"
            raise Difference(name, f"{name} is {pair[0]}, in the other run {pair[1]}", lines)


def alone(case: Case) -> None:
    accurate(case, case.solution, CALL)


def observed(case: Case) -> None:
    """Numbers at output times in place of points; and as many calls of f as ``nfev`` says."""
    if not case.program.observe:
        return
    code = scripts.OBSERVED.replace("STORE", "'all'" if case.program.derivatives else "'observed'")
    code = code.replace("NAME", "f" if case.program.compiled else "counted")
    run, solution = case.run(code), case.solution
    s = run["s"]
    own = [run["observe"](t, y) for t, y in zip(solution.t, solution.y, strict=True)]
    if not np.array_equal(s.observed, np.array(own).reshape(s.observed.shape)):
        raise Difference("observed", "observed isn't the function of the points", code)
    same(solution, s, ("t", "nfev", *EVENTS, *COUNTS), code)
    calls = run["calls"][0]
    # calls of compiled functions aren't seen, differences and the search for friction not counted,
    # and f is evaluated again for the message of a failure
    exempt = case.program.compiled or case.program.derivatives == "forward" or not s.success
    if calls != s.nfev and not exempt and case.program.method not in SPLITTINGS:
        raise Difference("nfev", f"nfev is {s.nfev}, there are {calls} calls", code)


def same_without_output(case: Case) -> None:
    program, solution = case.program, case.solution
    if program.output is None and not program.dense:
        return
    code = CALL.replace("**options", "**{**options, 't_eval': None, 'dense_output': False}")
    plain = case.solve(code)
    same(solution, plain, (*EVENTS, *COUNTS), code)
    of_events = {t for times in plain.t_events or () for t in times}
    at_steps = {t: y for t, y in zip(plain.t, plain.y, strict=True) if t not in of_events}
    for t, y in zip(solution.t, solution.y, strict=True):
        if t in at_steps and not np.array_equal(y, at_steps[t]):
            text = f"the point at the end of a step, {t!r}, changes with output"
            raise Difference("output", text, CALL)


def with_fixed_steps(case: Case) -> None:
    """`integrate` takes the steps of `solve_ivp`."""
    if not case.program.steps:
        return
    code = CALL.replace("solve_ivp", "integrate")
    same(case.solution, case.solve(code), ("t", "y", "nfev", "nexp", *DERIVATIVES), code)


def step_by_step(case: Case) -> None:
    """Steps of a `Stepper`, copied, pickled and continued, are those of `solve_ivp`."""
    if any(zero.jump and zero.terminal for zero in case.program.events):
        return  # a stepper makes the last jump too
    code = f"COPIES, DENSE = {case.program.compiled == 'numba'}, False\n"
    code += scripts.STEPPER + scripts.STEPS
    plain = case.solve(f"{scripts.STEPPING}s = cg.solve_ivp(g, span, y0, **stepping)")
    run = case.run(code)
    grid = np.linspace(*case.path.task.span, int(case.program.steps) + 1)
    stops = (*case.path.task.breakpoints, *case.path.task.knots, *grid)
    ends = (*case.path.jumps, case.path.end) if case.path.terminated else case.path.jumps
    met = any(abs(t - stop) < 1e-9 * case.length for t in ends for stop in stops)
    # a stepper keeps the interpolant of a step at whose end the solution jumps or ends
    same(plain, run["s"], EVENTS if met else (*EVENTS, *EVALUATIONS, "nrejected"), code)
    t, y = np.array(run["t"]), np.array(run["y"])
    if not np.array_equal(plain.y, y):
        lines = f"{CALL}\nprint(s.y)\n{code}\nprint(y)"
        raise Difference("y", "points of a Stepper differ", lines)
    if not np.array_equal(plain.t, t):
        lines = f"{CALL}\nprint(s.t)\n{code}\nprint(t)"
        raise Difference("t", "times of a Stepper differ", lines)


def advanced(case: Case) -> None:
    """A `Stepper` advances to times, restarts there, then earlier, then from another point."""
    program, task = case.program, case.path.task
    if program.steps or program.length == 0 or case.jumps():
        return  # other fixed steps have no bound; where there are jumps, `together` restarts
    if any(zero.terminal for zero in program.events):
        return  # `advance` may stop before its goal
    times = [program.at(share) for share in (0.31, 0.77, 1.0)]
    code = scripts.STEPPER + scripts.GOALS.replace("GOALS", str(times))
    _near(case, times, case.run(code)["y"], code)
    earlier = f"s.restart(t={times[0]!r}, y=y[0])\ns.advance({times[1]!r})\ny = [s.y]\n"
    _near(case, [times[1]], case.run(code + earlier)["y"], code + earlier)
    rest = tuple(0.9 * value for value in task.rest)
    changed = f"t={times[0]!r}, y=other{', parameters=0.9 * parameters' * program.parameters}"
    code += f"s.restart({changed})\ns.advance({times[2]!r})\ny = [s.y]\n"
    moved = solve(replace(
        task, span=(times[0], times[2]), y0=case.names["other"], rest=rest, events=()
    ))  # fmt: skip
    other = replace(case, path=moved, program=replace(program, events=()))
    _near(other, [times[2]], case.run(code)["y"], code)


def together(case: Case) -> None:
    """Members of a `Stepper` are those of `solve_ensemble`, and of single steppers."""
    program, events = case.program, case.program.events
    if program.steps and program.turns > 2.0 and program.frame.phase:
        raise Unclear("momenta along points of spheres are errors of long steps, and are refused")
    ways = ("", *scripts.VECTORIZED[: not program.compiled])
    ways += scripts.EVENTS_TOGETHER[: len(ways)] if events else ()
    way = ways[program.seed % len(ways)]
    copied = program.compiled == "numba" or "many" in way
    goals = [program.at(share) for share in (0.31, 0.77, 0.77, 1.0)]
    values = (
        copied,
        program.dense or program.endless,
        EVALUATIONS,
        EVENTS if events else (),
        goals,
    )
    begin = f"{_data_of_members(program)}COPIES, DENSE, EVALUATIONS, EVENTS, GOALS = {values}\n"
    last_jump = any(zero.jump and zero.terminal for zero in events)  # a single stepper makes it too
    for code in (
        scripts.COMMON_STEPS * (not case.jumps()),  # refused
        scripts.OWN_STEPS * (not program.endless),
        scripts.SINGLE * (program.length != 0 and not last_jump),
    ):
        case.run(begin + code.replace("WAY", way))


@cache
def pool() -> concurrent.futures.Executor:
    return concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))


def processes(case: Case) -> None:
    """Members are integrated by another process."""
    if case.program.compiled != "numba":  # which can't be pickled
        case.names["pool"] = pool()
        members(case, (", executor=pool",), ())


def _data_of_members(program: Program) -> str:
    """Return the code of options of three members, of which the second has its own."""
    code = f"{scripts.TOGETHER}several, second, swapped = dict(options), dict(options), {{}}\n"
    for name, of in (("members", "several"), ("mirrored", "second"), ("swapped", "swapped")):
        if program.inputs:
            code += f"{of}['inputs'] = {program.named_inputs(name)}\n"
    if program.parameters:
        code += f"second['parameters'] = {1.0 if program.endless else 0.9} * parameters\n"
        code += "several['parameters'] = np.stack([parameters, second['parameters'], parameters])\n"
        code += "swapped['parameters'] = several['parameters'][[1, 0, 1]]\n"
    return code


def members(
    case: Case,
    ways: Sequence[str] = ("", ", workers=2", *scripts.VECTORIZED, *scripts.EVENTS_TOGETHER),
    common: Sequence[str] = (
        ", common_steps=True",
        ", common_steps=True, vectorized=True",
        " | many, common_steps=True",
    ),
) -> None:
    """Members of an ensemble are equal to single solutions, however they are computed."""
    program = case.program
    code = _data_of_members(program)
    ways, common = ([way for way in each if program.events or "many" not in way]
                    for each in (ways, common))  # fmt: skip
    if program.endless and program.output is None and not program.dense:
        code += "several['t_eval'] = [span[0]]\n"
    apart = program.inputs and program.seed % 2 == 1  # a list of inputs, with times of their own
    if apart:
        code += f"second['inputs'] = {program.named_inputs('moved')}\n"
        code += "several['inputs'] = [each['inputs'] for each in (options, second, options)]\n"
    single = case.solve(code + CALL.replace("y0, **options", "other, **second"))
    code += "s = cg.solve_ensemble(f, span, np.stack([y0, other, y0]), **several"
    for way in (way for way in ways if not (program.compiled and "vectorized" in way)):
        s = case.solve(f"{code}{way})")
        if "vectorized" in way and program.derivatives:  # differences of other roundings
            accurate(case, s[0], f"{code}{way})[0]")
            continue
        for i, own in enumerate((case.solution, single, case.solution)):
            # without times of output an ensemble stores the ends alone
            compared = ("t", "y", *DERIVATIVES, *EVALUATIONS) if program.output is not None else ()
            same(own, s[i], (*compared, *EVENTS, *COUNTS), f"{code}{way})[{i}]")
            if own.status == 0 and not np.array_equal(s[i].y[-1:], own.y[-1:]):
                text = f"the end of member {i} differs"
                raise Difference("end", text, f"{code}{way})\nprint(s.y)")
    if case.jumps() or apart:
        return  # refused with common steps
    for way in (way for way in common if not (program.compiled and "vectorized" in way)):
        s = case.solve(f"{code}{way})")
        same(s[0], s[2], ("t", "y", *EVENTS), f"{code}{way})")
        if not program.endless:
            accurate(case, s[0], f"{code}{way})[0]")


# Derivatives and other callers


def _changes(case: Case) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return coordinates of a change of the start, and the changes of what f is given."""
    program, space = case.program, case.program.frame
    rng = np.random.default_rng(program.seed + 5)
    xi = rng.uniform(-1, 1, space.coordinates)
    changes = {"y0": space.tangent(xi, case.names["y0"])}
    if program.parameters:
        changes["parameters"] = rng.uniform(-1, 1, 2)
    return xi, changes


def _numbers(case: Case, step: float, changes: dict, times: Sequence[float]) -> np.ndarray:
    """Return points at times and then the times of events, of the changed problem."""
    path = solve(case.program.task(case.names, step, **changes))
    if [len(events) for events in path.events] != [len(events) for events in case.path.events]:
        raise Unclear("events change with the start")
    happened = [t for events in path.events for t, *_ in events]
    return np.concatenate([*(path(t) for t in times), happened])


def _check_derivative(case: Case, ours: Any, expected: Any, code: str) -> None:
    error = float(np.abs(ours - expected).max(initial=0.0))
    # differences multiply the rounding of f, which is that of t in parts of the span
    floor = 1e-7 + 4e5 * EPS * abs(case.program.start) / case.length
    if error > case.bound + floor:
        _doubt(case)
        bound = case.grown() * (1 + floor / case.bound)
        if error > bound:
            text = f"a derivative is off by {error:.2e}, bound {bound:.2e}"
            text += f": {np.array(ours)}, of the model {np.array(expected)}"
            raise Difference("derivative", text, code)


def derivatives(case: Case) -> None:
    if not case.program.derivatives or np.isinf(case.bound):
        return
    if case.program.steps:  # `_bound` is that of points
        raise Unclear(NO_BOUND)
    forward(case) if case.program.derivatives == "forward" else backward(case)


def forward(case: Case) -> None:
    """Derivatives and covariances by the variational equation."""
    program, space, s = case.program, case.program.frame, case.solution
    xi, changes = _changes(case)
    kept = [i for i, t in enumerate(s.t) if not case.near_jump(t)]
    model = difference(lambda step: _numbers(case, step, changes, s.t[kept]))
    points, happened = np.split(model, [len(kept) * reals(space.base).size])
    lines = f"{CALL}\nprint(s.transition, s.sensitivity)  # xi = {xi.tolist()}, {changes}"
    for i, row in zip(kept, points.reshape(len(kept), reals(space.base).size), strict=True):
        coordinates = s.transition[i] @ xi
        if program.parameters:
            coordinates = coordinates + s.sensitivity[i] @ changes["parameters"]
        _check_derivative(case, space.tangent(coordinates, s.y[i]), row, lines)
    if program.events and sum(map(len, s.t_events)) != len(happened):
        raise Unclear("the number of events depends on errors")  # or `alone` has raised
    elif program.events:
        change = np.append(xi, changes.get("parameters", []))
        ours, slopes = np.concatenate(s.dt_events) @ change, np.concatenate(case.path.slopes)
        scale = np.minimum(1.0, slopes)
        _check_derivative(case, ours * scale, happened * scale, lines)
    elif reals(space.base).size <= 9 and program.output is None:
        fields = np.stack([space.tangent(e, s.y[-1]) for e in np.eye(space.coordinates)], axis=1)
        ours = fields @ s.covariance[-1] @ fields.T
        spread = np.diag(np.arange(1.0, space.coordinates + 1)) / program.length * program.noisy
        model = covariance(case.path.task, 0.1 * np.eye(space.coordinates), spread)
        size = max(1.0, float(np.abs(model).max()))
        _check_derivative(
            case, ours / (2 * size), model / (2 * size), f"{CALL}\nprint(s.covariance)"
        )


def backward(case: Case) -> None:
    """The gradient of one number by the start, parameters and inputs, by the adjoint equation."""
    program, space, s = case.program, case.program.frame, case.solution
    if not s.success:  # whether it may fail is compared elsewhere
        raise Unclear("the solution has failed")
    rng = np.random.default_rng(7)
    xi, changes = _changes(case)
    for k, samples in enumerate(program.inputs):
        changes[f"values{k}"] = samples.scale * rng.uniform(-1, 1, samples.count)
    rows = range(len(s.t)) if program.output else [-1]
    # errors at several times add up as their root mean square does
    weights = rng.uniform(-1, 1, (len(rows), reals(space.base).size)) / np.sqrt(len(rows))
    cotangent = np.array([
        [weight @ space.tangent(e, s.y[i]) for e in np.eye(space.coordinates)]
        for i, weight in zip(rows, weights, strict=True)
    ])  # fmt: skip
    cotangent = cotangent if program.output else cotangent[0]
    code = f"{CALL}\ng = s.gradient(np.array({cotangent.tolist()}))"
    g = case.run(code)["g"]
    inputs = g.inputs if isinstance(g.inputs, tuple) else (g.inputs,)
    ours = g.y0 @ xi + (g.parameters @ changes["parameters"] if program.parameters else 0.0)
    ours += sum(np.sum(inputs[k] * changes[f"values{k}"]) for k in range(len(program.inputs)))
    expected = difference(lambda step: _numbers(case, step, changes, s.t[rows]))
    lines = f"{code}\nprint(g)  # xi = {xi.tolist()}, {changes}"
    _check_derivative(case, ours, weights.ravel() @ expected, lines)


def in_jax(case: Case) -> None:
    """The solver for JAX, and its derivatives by parameters."""
    program = case.program
    code = scripts.JAX.replace("REST", "(parameters,)" if program.parameters else "()")
    run = case.run(code)
    times = np.linspace(program.start, program.end, 4)[1:]
    _near(case, times, np.array(run["y"]), code)
    if program.parameters:
        weights = np.random.default_rng(7).uniform(-1, 1, run["y"].shape)
        changes = {"parameters": np.array([1.0, 0.5])}
        ours = float(run["slope"](weights)[0][0] @ changes["parameters"])
        expected = difference(lambda step: _numbers(case, step, changes, times))
        _check_derivative(case, ours, weights.ravel() @ expected, code)


ALWAYS = alone, observed, same_without_output, with_fixed_steps, derivatives
CALLERS = {
    caller.__name__: caller
    for caller in (step_by_step, advanced, members, together, processes, in_jax)
}
