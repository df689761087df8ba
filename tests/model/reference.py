"""A slow integrator that does what `docs/integration.md` says, by SciPy in the space around.

Between stops (breakpoints, times of samples, events with jumps) `DOP853` follows the solution with
tolerances of 1e-12. Events are zeros of their functions along its continuous solution, first seen
on a fine grid. Nothing here is fast, and nothing is shared with `cg`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import OdeSolution, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from tests.model.spaces import Space, reals

GRID = 300  # points at which functions of events are compared, in the whole span
KICK = 1e-6  # size of the perturbations that show how errors grow


@dataclass(frozen=True)
class Task:
    """An initial value problem. ``f``, events and jumps take ``(t, y, *inputs, *rest)``.

    An event has a ``function``, its ``terminal`` number of times, zero for never, its
    ``direction``, and a ``jump`` and a ``period``, or None.
    """

    space: Space
    f: Callable
    span: tuple[float, float]
    y0: np.ndarray
    events: Sequence[Any] = ()
    breakpoints: Sequence[float] = ()
    curves: Sequence[Callable] = ()
    knots: Sequence[float] = ()
    rest: tuple = ()

    def arguments(self, t: float) -> tuple:
        values = tuple(curve(t) for curve in self.curves)
        inputs = values if len(values) < 2 else (values,)
        return (*inputs, *self.rest)

    def point(self, z: np.ndarray) -> np.ndarray:
        base = self.space.base
        return np.ascontiguousarray(z).view(base.dtype).reshape(base.shape)

    def derivative(self, t: float, z: np.ndarray) -> np.ndarray:
        y = self.point(z)
        v = np.asarray(self.f(t, y, *self.arguments(t)), dtype=float).reshape(-1)
        if not np.isfinite(v).all():  # out of the domain of f, where it stands still
            v = np.nan_to_num(v)
        return reals(self.space.field(v, y))


def curve(kind: str, times: np.ndarray, values: np.ndarray) -> Callable:
    """Return the function of time of samples of one number."""
    if kind == "linear":
        return lambda t: float(np.interp(t, times, values))
    if kind == "cubic":
        spline = CubicSpline(times, values)
        return lambda t: float(spline(t))
    if kind == "averages":
        sums = np.concatenate([[0.0], np.cumsum(values * np.diff(times))])
        rate = CubicSpline(times, sums).derivative()
        return lambda t: float(rate(t))
    slopes = np.zeros(len(values))
    middles = (times[: len(values)] + np.append(times, np.inf)[1 : len(values) + 1]) / 2
    if kind == "causal":
        slopes[1:] = np.diff(values) / np.diff(middles)

    def of_one_interval(t: float) -> float:
        k = min(max(int(np.searchsorted(times, t, "right")) - 1, 0), len(values) - 1)
        return float(values[k] + (slopes[k] * (t - middles[k]) if slopes[k] else 0.0))

    return of_one_interval


@dataclass
class Path:
    """A solution: pieces between stops, and what happened.

    ``events`` has times in order, the points before and after, and whether there was a jump.
    """

    task: Task
    pieces: list[tuple[float, float, OdeSolution]] = field(default_factory=list)
    events: list[list[tuple[float, np.ndarray, np.ndarray, bool]]] = field(default_factory=list)
    jumps: list[float] = field(default_factory=list)
    nearest: list[float] = field(default_factory=list)  # of each event |g| where it nearly is zero
    slopes: list[list[float]] = field(default_factory=list)
    end: float = 0.0
    last: np.ndarray = field(default_factory=lambda: np.zeros(0))
    terminated: bool = False

    def __call__(self, t: float) -> np.ndarray:
        """Return the reals of the point at t, behind jumps at that time."""
        forward = self.task.span[1] >= self.task.span[0]
        if not self.pieces or t == self.end:
            return self.last
        for begin, _, solution in reversed(self.pieces):
            if t >= begin if forward else t <= begin:
                return solution(t)
        return self.pieces[0][2](self.pieces[0][0])


def within(t: float, begin: float, end: float) -> float:
    """Return t as seen from inside a piece, so that functions see their side of its ends."""
    low, high = sorted((np.nextafter(begin, end), np.nextafter(end, begin)))
    return float(min(max(t, low), high)) if low <= high else (begin + end) / 2


def solve(task: Task, kicks: Sequence[tuple[float, int]] = (), rtol: float = 1e-12) -> Path:
    """Return the solution, perturbed at given times in random directions with given seeds."""
    t, end = task.span
    path = Path(task, events=[[] for _ in task.events], slopes=[[] for _ in task.events])
    path.nearest = [np.inf] * len(task.events)
    inner = {*task.breakpoints, *task.knots, *(time for time, _ in kicks)}
    stops = sorted((s for s in inner if min(t, end) < s < max(t, end)), reverse=end < t)
    z = reals(task.y0).copy()
    signs = _signs(task, t, z, within(t, t, end))
    for stop in [*stops, end]:
        for time, seed in kicks:
            if time == t:
                xi = np.random.default_rng(seed).standard_normal(task.space.coordinates)
                tangent = task.space.tangent(xi, task.point(z))
                z = z + KICK * tangent / max(np.linalg.norm(tangent), 1e-300)
        while t != stop and not path.terminated:
            run = solve_ivp(
                lambda s, x, a=t, b=stop: task.derivative(within(s, a, b), x), (t, stop), z,
                method="DOP853", rtol=rtol, atol=rtol / 10, dense_output=True,
                max_step=abs(stop - t) / 2,
            )  # fmt: skip
            if not run.success:
                raise ArithmeticError(run.message)
            t, z, signs = _record_piece(path, run.sol, t, stop, signs)
            if len(path.jumps) > 500:
                raise ArithmeticError("jumps follow each other without end")
        if path.terminated:
            break
    path.end, path.last = t, z
    return path


def value_of(task: Task, event: Any, t: float, z: np.ndarray) -> float:
    """Return the value of an event's function, the nearest to zero that a period admits."""
    value = float(event.function(t, task.point(z), *task.arguments(t)))
    return math.remainder(value, event.period or math.inf)


def _signs(task: Task, t: float, z: np.ndarray, seen: float) -> list[float]:
    """Return the signs of the functions at a start, zero where they are zero to rounding."""
    values = [value_of(task, event, seen, z) for event in task.events]
    return [0.0 if abs(value) < 1e-9 else np.sign(value) for value in values]


def _record_piece(
    path: Path, solution: OdeSolution, begin: float, end: float, signs: list[float]
) -> tuple[float, np.ndarray, list[float]]:
    """Record a piece and the events in it; return where it ends, its last point and the signs."""
    task = path.task
    length = abs(end - begin) / (abs(task.span[1] - task.span[0]) or 1.0)
    grid = np.linspace(begin, end, 12 + int(GRID * length))
    roots, after = [], []
    for k, event in enumerate(task.events):
        own, sign = _zeros(path, k, event, solution, grid, signs[k])
        roots += [(t, k, slope) for t, slope in own]
        after.append(sign)
    for t, group in _grouped(task, roots, begin < end):
        stays = solution(t)
        last = [k for k in group if len(path.events[k]) + 1 >= (task.events[k].terminal or np.inf)]
        jumping = [k for k in group if task.events[k].jump and k not in last]
        for k in sorted(group, key=lambda k: (k in jumping, k)):
            before = stays
            if k in jumping:
                jumped = task.events[k].jump(t, task.point(stays), *task.arguments(t))
                stays = reals(np.asarray(jumped, dtype=task.space.base.dtype))
            path.events[k].append((t, before, stays, k in jumping))
            path.slopes[k].append(max(group[k], 1e-300))
        if last or jumping:
            path.pieces.append((begin, t, solution))
            path.jumps += [t] if jumping else []
            path.terminated = bool(last)
            return t, stays, _signs(task, t, stays, within(t, t, end))
    path.pieces.append((begin, end, solution))
    return end, solution(end), after


def _zeros(
    path: Path, k: int, event: Any, solution: OdeSolution, grid: np.ndarray, sign: float
) -> tuple[list[tuple[float, float]], float]:
    """Return zeros where the sign of an event changes, and slopes there; and the last sign."""
    task, begin, end = path.task, grid[0], grid[-1]

    def value(t: float) -> float:
        return value_of(task, event, within(t, begin, end), solution(t))

    values = np.array([value(t) for t in grid])
    roots, last, starts = [], 0, not sign
    for i, g in enumerate(values):
        least = 1e-9 if i == 0 and not sign else 1e-11  # behind an event, see `_signs`
        new = 0.0 if abs(g) < least and i in (0, len(grid) - 1) else np.sign(g)
        if new and sign and new != sign and abs(g) < (event.period or np.inf) / 4:
            bracketed = values[last] * g < 0
            root = brentq(value, grid[last], grid[i], xtol=1e-15) if bracketed else begin
            if event.direction * new >= 0:
                j = max(i, 1)
                roots.append((float(root), abs((values[j] - values[j - 1]) / (grid[1] - grid[0]))))
        if new:
            sign, last = new, i
    size = np.abs(values)
    dips = (size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:])
    dips &= (np.sign(values[:-2]) == np.sign(values[2:])) & (values[1:-1] * values[:-2] > 0)
    dips = [starts and 0.0 < size[0] < 1e-9, *dips, False]  # or is zero at the start by rounding
    path.nearest[k] = min([path.nearest[k], *size[dips]])
    return roots, sign


def _grouped(
    task: Task, roots: list[tuple[float, int, float]], forward: bool
) -> list[tuple[float, dict[int, float]]]:
    """Return times in order with the events that happen then, and their slopes."""
    groups: list[tuple[float, dict[int, float]]] = []
    near = 1e-10 * (abs(task.span[1] - task.span[0]) + max(map(abs, task.span)))
    for t, k, slope in sorted(roots, key=lambda root: (root[0] if forward else -root[0], root[1])):
        if groups and abs(t - groups[-1][0]) <= near and k not in groups[-1][1]:
            groups[-1][1][k] = slope
        else:
            groups.append((t, {k: slope}))
    return groups


def growth(path: Path, times: Sequence[float], seeds: Sequence[int] = (1, 2)) -> float:
    """Return the factor by which perturbations of unit size grow, one or more.

    Points are kicked at the start and on the way. Times near jumps, which move, don't count.
    The result is infinite where the perturbed solution has other events.
    """
    begin, end = path.task.span
    largest = 1.0
    for seed in seeds:
        kicks = [(begin + share * (end - begin), seed + 10 * i)
                 for i, share in enumerate((0.0, 0.37, 0.71))]  # fmt: skip
        other = solve(path.task, kicks, rtol=1e-10)
        if [len(events) for events in other.events] != [len(events) for events in path.events]:
            return np.inf
        moved = list(zip([*path.jumps, path.end], [*other.jumps, other.end], strict=False))
        changes = [other.last - path.last]
        for t in times:
            if all(abs(t - a) > 100 * abs(a - b) + 1e-9 * abs(end - begin) for a, b in moved):
                changes.append(other(t) - path(t))
        largest = max(largest, *(float(np.abs(change).max()) / KICK for change in changes))
    return largest


def difference(numbers: Callable[[float], np.ndarray]) -> np.ndarray:
    """Return the derivative at zero, by a difference of order four."""
    a, b, c, d = (numbers(step) for step in (1e-4, -1e-4, 2e-4, -2e-4))
    return (8 * (a - b) - (c - d)) / 12e-4


def covariance(task: Task, initial: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Return the covariance of the last point's reals: S' = A S + S Aᵀ + E Q Eᵀ.

    A is the derivative of y' in the space around, E has the frame's fields as columns.
    """
    n, units = reals(task.y0).size, np.eye(task.space.coordinates)

    def fields(z):
        return np.stack([task.space.tangent(e, task.point(z)) for e in units], axis=1)

    def both(t, state, begin, end):
        t = within(t, begin, end)
        z, spread = state[:n], state[n:].reshape(n, n)
        step = 1e-5 * max(1.0, np.abs(z).max())
        change = [task.derivative(t, z + s) - task.derivative(t, z - s) for s in step * np.eye(n)]
        a, e = np.stack(change, axis=1) / (2 * step), fields(z)
        change = a @ spread + spread @ a.T + e @ density @ e.T
        return np.concatenate([task.derivative(t, z), change.reshape(-1)])

    t, end = task.span
    # in short spans far from zero times are rounded, and f with them
    tol = max(1e-8, 2e3 * np.spacing(max(abs(t), abs(end))) / abs(end - t))
    e0 = fields(reals(task.y0))
    state = np.concatenate([reals(task.y0), (e0 @ initial @ e0.T).reshape(-1)])
    stops = [s for s in {*task.breakpoints, *task.knots} if min(t, end) < s < max(t, end)]
    for stop in [*sorted(stops, reverse=end < t), end]:
        run = solve_ivp(both, (t, stop), state, "DOP853", args=(t, stop), rtol=tol, atol=tol / 100)
        t, state = stop, run.y[:, -1]
    return state[n:].reshape(n, n)
