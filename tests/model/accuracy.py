"""A program and its solutions, and whether these are those of the model, within a bound."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

import cg
from tests.model.programs import Program
from tests.model.reference import Path, growth, value_of
from tests.model.scripts import CALL
from tests.model.spaces import reals

TOLERANCES = 50  # admitted, times the growth of errors
EPS = float(np.finfo(float).eps)
EVENTS = "t_events", "y_events", "y_after"
SLOW = 0.05  # part of the span within which the function of an event must change by the bound
SAME = 1e-9  # part of the span within which times of the model are equal
COPY = 1e-10  # by how much the function of a copied event is less, see `Zero`


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
    short: float = 0.0  # a step size to compare with fixed steps
    solution: Any = None

    def run(self, code: str) -> dict[str, Any]:
        """Run a text behind the script; return all names."""
        names = dict(self.names)
        try:
            exec(code, names)
        except ModuleNotFoundError as error:  # JAX is an extra
            raise Unclear(str(error)) from error
        except Exception as error:
            if isinstance(error, ArithmeticError | cg.ConvergenceError) and self.program.steps:
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
        # 1e4 makes one half of 50 tolerances of 1e-6, and points are of size one
        if factor > 1e4 or factor * self.bound > 1.0:
            raise Unclear("errors grow too much")
        return factor * self.bound

    def beside_jump(self, t: float, error: float, moves: Sequence[float] | None = None) -> bool:
        """Return whether a time is so near a jump that it may be beyond it in another solution.

        The time of an event is off by the error of points divided by the slope of its function.
        ``moves`` are changes of these times in addition, those of all events.
        """
        events = [event for events in self.path.events for event in events]
        slopes = [slope for slopes in self.path.slopes for slope in slopes]
        moves = np.zeros(len(events)) if moves is None else moves
        return any(
            jumps and abs(t - at) <= error / slope + move + self.rounding(at)
            for (at, _, _, jumps), slope, move in zip(events, slopes, moves, strict=True)
        )

    def rounding(self, t: float) -> float:
        """Return the error of the model's time of an event."""
        return float(SAME * self.length + 8 * np.spacing(abs(t)))

    def jumps(self) -> bool:
        return any(zero.jump for zero in self.program.events)


def bound_of(case: Case) -> float:
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
    short = min([h, *gaps[gaps > 3e-3 * case.length]])
    plain = {"derivatives": None, "control_derivatives": False, "P0": None, "noise": None}
    try:
        sizes = h, float(short / 4), float(short / 16)
        runs = [case.solve(h=size, t_eval=ends, **plain) for size in sizes]
    except Unclear:
        return np.inf
    case.short = sizes[1]
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
        near(case, s.t, s.y, f"{code}\nprint(s.t, s.y)")
    if s.sol is not None and between:
        grid = np.clip(case.grid(), s.sol.t_min, s.sol.t_max)
        near(case, grid, s.sol(grid), f"{code}\nprint(s.sol({grid.tolist()}))")
    if case.program.events and between:
        _events(case, s, code)


def _reached(case: Case, s: Any, code: str) -> None:
    """Raise unless the status is that of the model, and times are those asked for."""
    program, path, times = case.program, case.path, s.t.tolist()
    slopes = sorted(slope for slopes in path.slopes for slope in slopes)
    if "leaves its function at zero" in s.message and slopes[0] < 0.1 * slopes[-1]:
        # rounding decides which of them is the last
        raise Unclear("jumps come ever faster")
    if not s.success:
        raise_if_singular(case)
    if s.success and s.status != int(path.terminated):
        raise_if_unclear(case)
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


def raise_if_singular(case: Case, power: int = 1) -> None:
    """Raise Unclear where rounding changes coordinates of a matrix by a tolerance.

    With the power 2, where it changes their derivatives, which are differences, by its root.
    """
    base = case.program.frame.base
    if base.ndim == 2 and base.shape[0] == base.shape[1]:
        points = [case.path(t).view(base.dtype).reshape(base.shape) for t in case.grid()]
        if EPS * max(map(np.linalg.cond, points)) ** power > 0.1 * case.program.rtol:
            raise Unclear("points are nearly singular matrices, without accurate coordinates")


def near(case: Case, times: Sequence[float], values: Any, code: str) -> None:
    """Raise unless points are those of the model, on the same side of each jump."""
    path, errors = case.path, []
    for t, value in zip(map(float, times), values, strict=True):
        beyond = path.terminated and (t - path.end) * np.sign(case.program.length) > 0
        expected = path(path.end if beyond else t)
        errors.append((float(np.abs(reals(value) - expected).max()), t, expected))
    errors = [each for each in errors if each[0] > case.bound]
    errors = [each for each in errors if not case.beside_jump(each[1], case.bound)]
    if not errors:
        return
    raise_if_unclear(case)
    bound = case.grown()
    errors = [each for each in errors if each[0] > bound and not case.beside_jump(each[1], bound)]
    if errors:
        error, t, expected = max(errors, key=lambda each: each[0])
        text = f"at t = {t!r} off by {error:.2e}, bound {bound:.2e}; the model has "
        raise Difference("point", text + str(expected.tolist()), code)


def _events(case: Case, s: Any, code: str) -> None:
    path = case.path
    expected = [[t for t, *_ in events] for events in path.events]
    if [len(times) for times in s.t_events] != [len(times) for times in expected]:
        raise_if_unclear(case)
        raise Difference("events", f"events {s.t_events}, of the model {expected}", code)
    for k, model in enumerate(path.events):
        for i, (exact, _, behind, jumps) in enumerate(model):
            t, before, after = (getattr(s, name)[k][i] for name in EVENTS)
            if not np.array_equal(reals(after), behind if jumps else reals(before)):
                text = f"y_after[{k}][{i}] isn't what the jump returns"
                raise Difference("jump", text, code)
            slope = path.slopes[k][i]
            rounding = case.rounding(exact)
            if abs(t - exact) <= case.bound / slope + rounding:
                continue
            raise_if_unclear(case)
            if abs(t - exact) > case.grown() / slope + rounding:
                raise Difference(
                    "time of an event",
                    f"event {k}, {i} at {t!r}, of the model {exact!r}",
                    f"{code}\nprint(s.t_events[{k}][{i}], 'is not', {exact!r})",
                )


def raise_if_unclear(case: Case) -> None:
    """Raise Unclear where events of the model depend on errors within the tolerance."""
    if not case.program.events:
        return
    bound, path, task = case.grown(), case.path, case.path.task
    for k, nearest in enumerate(path.nearest):
        if nearest < 2 * bound:
            raise Unclear(f"event {k} is nearly missed")
        if min(path.slopes[k], default=np.inf) * case.length * SLOW < bound:
            raise Unclear(f"event {k} is slow")
        begin, end = (
            abs(value_of(task, task.events[k], t, path(t))) for t in (task.span[0], path.end)
        )
        # exactly zero at the start is clear, but not at the other points of differences
        min_value = -1.0 if case.program.derivatives else 1e-9
        if min_value < begin < 2 * bound or (end < 2 * bound and not path.terminated):
            raise Unclear(f"event {k} is at an end")
    times = sorted(t for events in path.events for t, *_ in events)
    stops = (*task.breakpoints, *task.knots)
    if path.jumps and any(0 < abs(t - p) < SAME * case.length for t in times for p in stops):
        raise Unclear("an event is nearly at a stop")
    slope = min((slope for slopes in path.slopes for slope in slopes), default=1.0)
    # a copy of a copy is twice as far
    apart = COPY * sum(event.kind == "copy" for event in case.program.events)
    moved = (path.jumps or path.terminated) and apart
    if moved and any(8 * np.spacing(abs(t)) * min(slope, 1.0) < apart or t in stops for t in times):
        raise Unclear("events are 1e-10 apart, more than the resolution of time, or at a stop")
    gap = 2 * bound / slope
    if path.jumps and any(SAME * case.length < b - a < gap for a, b in pairwise(times)):
        raise Unclear("events come in an order that depends on errors")
