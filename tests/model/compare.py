"""Runs of a program, compared with the model and with each other.

Every function takes a `Case`, and raises `Difference` with a line of Python that fails behind the
program's script.
"""

import copy
import pickle
import warnings
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import cg
from tests.model.programs import SPLITTINGS, Program
from tests.model.reference import Path, covariance, growth, solve, tangents
from tests.model.spaces import reals

TOLERANCES = 50  # admitted, times the growth of errors


class Difference(AssertionError):
    """What differs, and a line that shows it behind the script of the program."""

    def __init__(self, text: str, line: str = ""):
        super().__init__(text)
        self.line = line


EPS = float(np.finfo(float).eps)


class Unclear(Exception):
    """The program has no definite answer: it depends on errors smaller than the tolerances."""


@dataclass
class Case:
    """A program, the names of its script, its solution and the model's."""

    program: Program
    names: dict
    solution: object
    path: Path
    bound: float  # of points

    @property
    def arguments(self):
        return self.names["f"], self.names["span"], self.names["y0"]


def check(program: Program) -> str:
    """Compare a program with the model; return "compared", or why there is no answer."""
    names = program.build()
    task = program.task(names)
    try:
        path = solve(task)
    except ArithmeticError:
        return "the model has no solution"
    if program.endless and not path.terminated:
        return "no event ends it"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error" if not program.steps else "ignore")
            solution = _run(program, names)
    except Unclear as reason:
        return str(reason)
    case = Case(program, names, solution, path, 0.0)
    try:
        case.bound = _bound(case)
        for compare in (
            finite, reached, points, events, observed, same_without_output, as_stepper, advanced,
            as_member, forward, backward, linear,
        ):  # fmt: skip
            compare(case)
    except Unclear as reason:
        return str(reason)
    return "compared"


CALL = "cg.solve_ivp(f, span, y0, **options)"


def _run(program, names, **changed):
    options = {**names["options"], **changed}
    try:
        return cg.solve_ivp(names["f"], names["span"], names["y0"], **options)
    except Exception as error:
        if program.steps and type(error).__name__ == "StepTooLongError":
            raise Unclear("steps are too long for the method") from error
        raise Difference(f"raised {type(error).__name__}: {error}", CALL) from error


def _bound(case) -> float:
    """Return 50 tolerances, or with fixed steps five times the change with a tenth of them."""
    program = case.program
    size = max([1.0, *(float(np.abs(case.path(t)).max()) for t in _grid(case))])
    floor = 1e-9 * size
    if not program.steps:
        return TOLERANCES * (program.atol + program.rtol * size) + floor
    fine = _run(program, case.names, h=case.names["options"]["h"] / 10, t_eval=_ends(case))
    whole = _run(program, case.names, t_eval=_ends(case))
    if len(fine.t) != len(whole.t):
        raise Unclear("steps are too long for events")
    changes = [float(np.abs(fine.y - whole.y).max())]
    pairs = zip(fine.t_events or (), whole.t_events or (), strict=True)
    for k, (near, far) in enumerate(pairs):
        if len(near) != len(far):
            raise Unclear("steps are too long for events")
        shifts = np.abs(near - far) * max([1.0, *case.path.slopes[k]])
        changes += [*shifts, float(np.abs(fine.y_events[k] - whole.y_events[k]).max(initial=0.0))]
    return 5 * max(changes) + floor


def _ends(case):
    begin, end = case.path.task.span[0], case.path.end
    inner = np.linspace(begin, end, 9)[1:-1] if end != begin else []
    return [begin, *inner] if not case.program.endless else [begin]


def _grid(case, n=23):
    begin, end = case.path.task.span[0], case.path.end
    return np.linspace(begin, end, n)


def _grown(case) -> float:
    """Return the bound of points times the growth of errors, which is computed when needed."""
    factor = growth(case.path, list(_grid(case)))
    if factor > 1e4:
        raise Unclear("errors grow too much")
    return factor * case.bound


def finite(case):
    arrays = {k: v for k, v in vars(case.solution).items() if isinstance(v, np.ndarray)}
    for name, array in arrays.items():
        if array.dtype.kind in "fc" and not np.isfinite(array).all():
            raise Difference(f"{name} is not finite", f"assert np.isfinite(({CALL}).{name}).all()")


def reached(case):
    program, solution, path = case.program, case.solution, case.path
    if not solution.success:
        slopes = [slope for slopes in path.slopes for slope in slopes]
        if "leaves its function at zero" in solution.message and min(
            slopes, default=1.0
        ) < 0.01 * max(slopes, default=0.0):
            raise Unclear("jumps come ever faster")
        raise Difference(solution.message, f"assert ({CALL}).success")
    if np.any(np.diff(solution.t) * np.sign(program.length or 1.0) <= 0):
        raise Difference("times aren't in order", f"print(({CALL}).t)")
    if not path.terminated:
        if solution.status != 0:
            _doubt(case)
            raise Difference(f"the model reaches the end: {solution.message}", f"print({CALL})")
        wanted = program.output
        expected = None if wanted is None else program.times(wanted)
        if expected is not None and solution.t.tolist() != expected:
            raise Difference(f"t is {solution.t}, not {expected}", f"print(({CALL}).t)")
        if expected is None and (solution.t[0] != program.start or solution.t[-1] != program.end):
            raise Difference(f"t ends at {solution.t[-1]!r}", f"print(({CALL}).t)")


def _doubt(case):
    """Raise Unclear where events of the model depend on errors within the tolerance."""
    bound, path = _grown(case), case.path
    length = abs(path.end - path.task.span[0]) or 1.0
    for k, nearest in enumerate(path.nearest):
        if nearest < 2 * bound:
            raise Unclear(f"event {k} is nearly missed")
        if min(path.slopes[k], default=np.inf) * length * 0.05 < bound:
            raise Unclear(f"event {k} is slow")
        begin, end = (
            abs(path.task.events[k].function(t, path.task.point(path(t)), *path.task.arguments(t)))
            for t in (path.task.span[0], path.end)
        )
        if 1e-9 < begin < 2 * bound or (end < 2 * bound and not path.terminated):
            raise Unclear(f"event {k} is at an end")
    times = sorted(t for events in path.events for t, *_ in events)
    stops = (*path.task.breakpoints, *path.task.knots)
    if path.jumps and any(0 < abs(t - stop) < 1e-9 * length for t in times for stop in stops):
        raise Unclear("an event is nearly at a stop")
    copied = any(event.kind == "copy" for event in case.program.events)
    if copied and (path.jumps or path.terminated) and any(16 * EPS * abs(t) < 1e-10 for t in times):
        raise Unclear("events are 1e-10 apart, more than the resolution of time")
    slopes = [slope for slopes in path.slopes for slope in slopes]
    gap = 2 * bound / min(slopes, default=1.0)
    if path.jumps and any(1e-9 * length < b - a < gap for a, b in pairwise(times)):
        raise Unclear("events come in an order that depends on errors")


def points(case):
    program, solution = case.program, case.solution
    times = list(solution.t) if program.method != "RadauIIA5" or program.output is None else []
    values = list(solution.y) if times else []
    if solution.sol is not None and program.method != "RadauIIA5":
        grid = np.clip(_grid(case), solution.sol.t_min, solution.sol.t_max)
        times, values = [*times, *grid], [*values, *solution.sol(grid)]
    worst, bound = _worst(case, times, values), case.bound
    if worst is None or worst[0] <= bound:
        return
    if case.program.events:
        _doubt(case)
    if worst[0] > (bound := _grown(case)):
        error, t, expected = worst
        source = (
            f"({CALL}).sol({t!r})"
            if t not in solution.t
            else (f"next(y for t, y in zip(*[({CALL}).t, ({CALL}).y]) if t == {t!r})")
        )
        raise Difference(
            f"at t = {t} off by {error:.2e}, bound {bound:.2e}",
            f"y = {source}\n"
            f"assert np.abs(np.ascontiguousarray(y).view(float).ravel() - "
            f"np.array({expected.tolist()})).max() < {bound:.2e}",
        )


def _worst(case, times, values):
    """Return the largest error with its time and the model's point; near jumps none counts."""
    path, worst = case.path, None
    length = abs(path.end - path.task.span[0])
    for time, value in zip(times, values, strict=True):
        t, beyond = float(time), (time - path.end) * np.sign(case.program.length) > 0
        if any(abs(t - jump) < 1e-2 * length for jump in path.jumps):
            continue
        expected = path(path.end if path.terminated and beyond else t)
        error = float(np.abs(reals(value) - expected).max())
        if worst is None or error > worst[0]:
            worst = error, t, expected
    return worst


def events(case):
    program, solution, path = case.program, case.solution, case.path
    if not program.events or program.method == "RadauIIA5":
        return
    found = [list(times) for times in solution.t_events]
    expected = [[t for t, *_ in events] for events in path.events]
    length = abs(path.end - path.task.span[0]) or 1.0
    if list(map(len, found)) != list(map(len, expected)):
        _doubt(case)
        raise Difference(
            f"events {found}, of the model {expected}",
            f"assert [len(t) for t in ({CALL}).t_events] == {list(map(len, expected))}",
        )
    for k, (times, model) in enumerate(zip(found, expected, strict=True)):
        for i, (t, exact) in enumerate(zip(times, model, strict=True)):
            _same_jump(case, k, i)
            slope = path.slopes[k][i]
            rounding = 1e-9 * length + 8 * np.spacing(abs(exact))
            if abs(t - exact) <= case.bound / slope + rounding:
                continue
            _doubt(case)
            if abs(t - exact) > _grown(case) / slope + rounding:
                raise Difference(
                    f"event {k}, {i} at {t!r}, of the model {exact!r}",
                    f"print(({CALL}).t_events[{k}][{i}], 'is not', {exact!r})",
                )


def _same_jump(case, k, i):
    """The point after an event is what the jump returns, or that before it."""
    before, after = (
        reals(points[k][i]) for points in (case.solution.y_events, case.solution.y_after)
    )
    *_, behind, jumps = case.path.events[k][i]
    target = behind if jumps else before
    if not np.array_equal(after, target):
        raise Difference(
            f"after event {k}, {i} the point isn't that of the jump",
            f"print(({CALL}).y_after[{k}][{i}])  # {target.tolist()}",
        )


def observed(case):
    """Numbers at output times in place of points; and as many calls of f as ``nfev`` says."""
    program, solution, calls = case.program, case.solution, [0]
    if not program.observe:
        return

    def observe(t, y, *rest):
        return [t, float(np.abs(y).sum())]

    def counted(*arguments):
        calls[0] += 1
        return case.names["f"](*arguments)

    f = case.names["f"] if program.compiled else counted
    run = cg.solve_ivp(
        f, *case.arguments[1:], **case.names["options"], observe=observe, store="observed"
    )
    line = "print(cg.solve_ivp(f, span, y0, **options, observe=lambda t, *_: t).observed)"
    own = [observe(t, y) for t, y in zip(solution.t, solution.y, strict=True)]
    if not np.array_equal(run.observed, np.array(own).reshape(run.observed.shape)):
        raise Difference("observed isn't the function of the points", line)
    if not np.array_equal(run.t, solution.t) or run.nfev != solution.nfev:
        raise Difference("t or nfev change with store='observed'", line)
    if calls[0] != run.nfev and f is counted and program.method not in SPLITTINGS:
        raise Difference(f"nfev is {run.nfev}, there are {calls[0]} calls", line)
    if program.events:
        _same_events(solution, run, "observe=", line)


def same(case, other, text, line=""):
    """Raise unless two solutions are equal to the bit where they have the same output."""
    for name in ("t", "y"):
        ours, theirs = getattr(case.solution, name), getattr(other, name)
        if not np.array_equal(ours, theirs):
            raise Difference(f"{name} differs with {text}", line or f"# {text}")
    if case.program.events:
        _same_events(case.solution, other, text, line)


def _same_events(ours, theirs, text, line=""):
    for name in ("t_events", "y_events", "y_after"):
        for k, (a, b) in enumerate(zip(getattr(ours, name), getattr(theirs, name), strict=True)):
            if not np.array_equal(a, b):
                raise Difference(f"{name}[{k}] differs with {text}", line or f"# {text}")


def same_without_output(case):
    program, solution = case.program, case.solution
    if program.output is None and not program.dense:
        return
    plain = _run(program, case.names, t_eval=None, dense_output=False)
    if (plain.steps, plain.nrejected) != (solution.steps, solution.nrejected):
        raise Difference(
            f"{solution.steps} steps, {solution.nrejected} rejected; without output "
            f"{plain.steps}, {plain.nrejected}",
            f"assert ({CALL}).steps == cg.solve_ivp(f, span, y0, **"
            "{**options, 't_eval': None, 'dense_output': False}).steps",
        )
    if program.events:
        _same_events(plain, solution, "no output")
    at_steps = dict(zip(plain.t, plain.y, strict=True))
    for t, y in zip(solution.t, solution.y, strict=True):
        if t in at_steps and t not in case.path.jumps and not np.array_equal(y, at_steps[t]):
            if program.events and any(t in times for times in plain.t_events):
                continue
            raise Difference(f"the point at the end of a step, {t!r}, changes with output", CALL)


def as_stepper(case):
    """Steps of a `Stepper`, copied, pickled and continued, are those of `solve_ivp`."""
    program = case.program
    if program.caller != "stepper" or program.endless:
        return
    options = {
        k: v for k, v in case.names["options"].items() if k not in ("t_eval", "dense_output")
    }
    plain = cg.solve_ivp(*case.arguments, **options)
    f, span, y0 = case.arguments
    stepper = cg.Stepper(f, span[0], y0, span[1], **options)
    times, values, copies = [span[0]], [y0], 0
    while stepper.status != "finished" and len(times) < 10_000:
        message = stepper.step()
        if message and stepper.status == "failed":
            raise Difference(f"Stepper: {message}", "# Stepper")
        times.append(stepper.t)
        values.append(stepper.y)
        if stepper.status == "event":
            break
        if len(times) % 3 == 2:
            copies += 1
            whole = copies % 2 or program.compiled
            twin = copy.copy(stepper) if whole else pickle.loads(pickle.dumps(stepper))
            stepper.step() if stepper.status == "running" and copies % 4 == 3 else None
            stepper = twin
    if any(zero.jump and zero.terminal for zero in program.events):
        return  # a stepper makes the last jump too
    if program.events and any(zero.jump for zero in program.events):
        _same_events(plain, stepper, "Stepper")
        if not np.array_equal(values[-1], plain.y[-1]):
            raise Difference("the last point of a Stepper differs", "# Stepper")
        return
    if times != plain.t.tolist() or not np.array_equal(np.array(values), plain.y):
        raise Difference(
            "steps of a Stepper differ",
            "s = cg.Stepper(f, span[0], y0, span[1], **{k: v for k, v in options.items() if k not "
            "in ('t_eval', 'dense_output')})\nwhile s.status == 'running': s.step()\nprint(s.y)",
        )


def advanced(case):
    """A `Stepper` that advances to times, and restarts there, comes to the model's points."""
    program = case.program
    if program.caller != "stepper" or program.events or program.length == 0 or program.steps:
        return
    skipped = ("t_eval", "dense_output")
    options = {k: v for k, v in case.names["options"].items() if k not in skipped}
    f, span, y0 = case.arguments
    stepper, values = cg.Stepper(f, span[0], y0, span[1], **options), []
    times = [program.at(share) for share in (0.31, 0.77, 1.0)]
    for t in times:
        if stepper.advance(t) or stepper.t != t:
            raise Difference(f"Stepper.advance({t!r}) comes to {stepper.t!r}", "# Stepper.advance")
        values.append(stepper.y)
        if t != times[-1]:
            stepper.restart(y=stepper.y)
    worst = _worst(case, times, values)
    if worst[0] > case.bound and worst[0] > _grown(case):
        raise Difference(f"advance({worst[1]!r}) is off by {worst[0]:.2e}", "# Stepper.advance")


def as_member(case):
    """Members of an ensemble are equal to single solutions, however they are computed."""
    program = case.program
    if program.caller != "ensemble":
        return
    f, span, y0 = case.arguments
    options, other = dict(case.names["options"]), case.names["other"]
    if program.endless and program.output is None and not program.dense:
        options["t_eval"] = [span[0]]
    if "parameters" in options:
        options["parameters"] = np.stack([options["parameters"]] * 3)
    singles = [
        cg.solve_ivp(f, span, start, **{**case.names["options"], "dense_output": False})
        for start in (y0, other)
    ]
    ways = [{}, {"workers": 2}] + ([] if program.compiled else [{"vectorized": True}])
    for way in ways:
        many = cg.solve_ensemble(f, span, np.stack([y0, other, y0]), **options, **way)
        for i, single in enumerate((*singles, singles[0])):
            _same_member(program, many, i, single, way)


def _same_member(program, many, i, single, way):
    text = f"a member of an ensemble, {way}"
    line = (
        "m = cg.solve_ensemble(f, span, np.stack([y0, other, y0]), **{**options, "
        f"**{way}}}); s = cg.solve_ivp(f, span, [y0, other, y0][{i}], **options)\n"
        f"print(m[{i}].y - s.y)  # with parameters: np.stack([parameters] * 3)"
    )
    if program.events:
        _same_events(single, many[i], text, line)
    if program.output is None:
        if single.status == 0 and not np.array_equal(many[i].y[-1], single.y[-1]):
            raise Difference(f"the end differs of {text} {i}", line)
    elif many[i].t.tolist() != single.t.tolist() or not np.array_equal(many[i].y, single.y):
        raise Difference(f"t or y differs of {text} {i}", line)
    if (many[i].steps, many[i].nrejected) != (single.steps, single.nrejected):
        raise Difference(f"steps differ of {text} {i}", line)


def _tangent(case):
    """Return coordinates of a change of the start, its reals, and a change of parameters."""
    rng = np.random.default_rng(case.program.seed + 5)
    space = case.program.frame
    xi = rng.uniform(-1, 1, space.dim)
    change = rng.uniform(-1, 1, 2) * (case.program.parameters and not case.program.compiled)
    return xi, reals(space.field(xi, case.names["y0"])), change


VARIATIONAL = "s = cg.solve_variational(f, span, y0, control_derivatives=True, **options)"


def forward(case):
    """Derivatives by the variational equation, against differences of the model."""
    program, path, space = case.program, case.path, case.program.frame
    if program.caller != "variational" or not _has_derivatives(program):
        return
    given = {"control_derivatives": True, "P0": 0.1 * np.eye(space.dim)}
    density = np.diag(np.arange(1.0, space.dim + 1)) * (program.length > 0)
    if program.length > 0:
        given["noise"] = density / program.length
    solution = cg.solve_variational(*case.arguments, **given, **_derived(case))
    xi, tangent, change = _tangent(case)
    by_parameters = change.any()
    expected = tangents(path.task, tangent, change if by_parameters else 0.0, solution.t)
    for i, t in enumerate(solution.t):
        coordinates = solution.transition[i] @ xi
        if by_parameters:
            coordinates = coordinates + solution.sensitivity[i] @ change
        ours = reals(space.field(coordinates, solution.y[i]))
        error = float(np.abs(ours - expected[i]).max())
        if error > case.bound + 1e-7 and error > 10 * _grown(case) + 1e-7:
            raise Difference(
                f"the derivative at t = {t} is off by {error:.2e}",
                f"{VARIATIONAL}\ni = {i}; xi = np.array({xi.tolist()})\n"
                f"change = np.array({change.tolist()})  # of parameters, zeros for none\n"
                f"print(frame.field(s.transition[i] @ xi, s.y[i]))  # {expected[i].tolist()}",
            )
    if reals(space.base).size <= 9 and program.output is None:
        _covariance(case, solution, given["P0"], density / (program.length or 1.0))


def _covariance(case, solution, initial, density):
    """The covariance of the last point, in the space around."""
    task, end, space = case.path.task, solution.y[-1], case.program.frame
    fields = np.stack([reals(space.field(e, end)) for e in np.eye(space.dim)], axis=1)
    ours, expected = fields @ solution.covariance[-1] @ fields.T, covariance(task, initial, density)
    error, size = np.abs(ours - expected).max(), max(1.0, np.abs(expected).max())
    if error > (10 * case.bound + 1e-6) * size and error > (20 * _grown(case) + 1e-6) * size:
        raise Difference(
            f"the covariance at the end is off by {error:.2e}",
            f"# P0 = 0.1 I, noise = {np.diag(density).tolist()}\n{VARIATIONAL}\n"
            f"# in the space around: {expected.tolist()}",
        )


def _has_derivatives(program):
    return program.frame.brackets and not (
        program.frame.phase or program.steps or program.endless or program.length == 0
        or program.events or program.method == "RadauIIA5"
    )  # fmt: skip


def _derived(case):
    return {k: v for k, v in case.names["options"].items() if k != "events"}


def backward(case):
    """Gradients by the adjoint equation, against differences of the model."""
    program, path = case.program, case.path
    if program.caller != "adjoint" or not _has_derivatives(program):
        return
    options = {k: v for k, v in _derived(case).items() if k not in ("t_eval", "dense_output")}
    solution = cg.solve_variational(*case.arguments, derivatives="adjoint", **options)
    xi, tangent, _ = _tangent(case)
    end, space = solution.y[-1], program.frame
    weights = np.random.default_rng(7).uniform(-1, 1, reals(end).size)
    cotangent = np.array([weights @ reals(space.field(e, end)) for e in np.eye(space.dim)])
    ours = float(solution.gradient(cotangent).y0 @ xi)
    expected = float(weights @ tangents(path.task, tangent, 0.0, [path.end])[0])
    if abs(ours - expected) > case.bound + 1e-6 and abs(ours - expected) > 10 * _grown(case) + 1e-6:
        raise Difference(
            f"the gradient is {ours!r}, of the model {expected!r}",
            f"s = cg.solve_variational(f, span, y0, derivatives='adjoint', **options)\n"
            f"print(s.gradient(np.array({cotangent.tolist()})).y0 @ np.array({xi.tolist()}), "
            f"'is not', {expected!r})",
        )


def linear(case):
    """`solve_linear`, where f depends on time alone."""
    program, path = case.program, case.path
    if program.caller != "linear" or program.form == "state" or program.frame.phase:
        return
    if program.compiled or program.frame.returned != (-1,) or program.steps:
        return
    options = {k: v for k, v in case.names["options"].items() if k != "method"}
    f, span, y0 = case.arguments

    def a(t, *rest):
        return f(t, y0, *rest)

    solution = cg.solve_linear(a, span, y0, **options)
    if path.terminated or any(zero.jump for zero in program.events):
        return
    worst = _worst(case, list(solution.t), list(solution.y))
    if worst and worst[0] > case.bound and worst[0] > _grown(case):
        raise Difference(
            f"solve_linear at t = {worst[1]} is off by {worst[0]:.2e}, bound {case.bound:.2e}",
            "s = cg.solve_linear(lambda t, *rest: f(t, y0, *rest), span, y0, **{k: v for k, v in "
            f"options.items() if k != 'method'}})\nprint(s.t, s.y, {worst[2].tolist()})",
        )
