"""Linear equations: Magnus methods beside other methods, QuTiP and SciPy."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import cg
from cg import _core_r64
from cg.frames import LinearAction
from cg.integration.step.plan import has_brackets

from .linear_cases import LinearCase, Solve, dop853, linear_cases, qutip_solver, with_qutip
from .record import Aim, Result, Row
from .solvers import Run, pairs
from .timing import measure
from .work_curves import Curve, Point

TITLE = "Linear equations"

_ERRORS = (1e-6, 1e-9, 1e-12)
_SLOWEST = 2.0  # seconds; after a longer run smaller tolerances are left out
_MIN_ORDER = 4
_OWN, _IVP, _QUTIP, _SCIPY = "solve_linear", "solve_ivp", "QuTiP's vern9", "SciPy's DOP853"
_NO_QUTIP = "- QuTiP was not installed, so there is no comparison with it."


def method_text(rounds: int) -> str:
    """Return how methods are compared."""
    return (
        "Five equations `y' = A(t) y` with `a(t)` in Python, for tolerances from 1e-3 to 1e-13; "
        "work for a given error at the end is interpolated. Exponentials and evaluations of "
        "`cg.solve_linear` are those of the Magnus method that needs fewest, then those of the "
        "Munthe-Kaas pair that needs fewest, which takes one exponential per step; both are "
        "compared with the pair of order four or higher, with frozen fields or of Munthe-Kaas, "
        "that needs fewest in `cg.solve_ivp`. On `LinearAction`, the last two equations, products "
        "of A(t) with vectors are counted in place of exponentials, and the method is the default, "
        "interpolation at nine nodes; each evaluation of SciPy's DOP853 is such a product. "
        "Times are those of the default methods of `cg.solve_linear` and "
        "`cg.solve_ivp` on the same frame, of QuTiP's `sesolve` or `mesolve` with "
        '`method="vern9"`, and of SciPy\'s DOP853 on the entries, with matrices in NumPy or SciPy; '
        f"medians of {rounds} rounds of all solvers in turn."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Compare exponentials, evaluations and times at equal errors."""
    rounds = 1 if quick else 11
    rows: list[Row] = []
    for problem in linear_cases(quick):
        rows += _work_rows(problem, quick) + _time_rows(problem, rounds, quick)
    return Result(TITLE, method_text(rounds), tuple(rows), () if with_qutip() else (_NO_QUTIP,))


def tolerances(quick: bool) -> list[float]:
    """Return the tolerances, large first."""
    return [10.0**-k for k in range(3, 9 if quick else 14)]


def linear_solver(problem: LinearCase, name: str) -> Solve:
    """Return a method of `cg.solve_linear`."""
    case = problem.case

    def solve(tolerance: float) -> Run:
        solution = cg.solve_linear(
            problem.a, (0.0, case.end), case.y0, frame=case.frame, method=name, rtol=tolerance,
            atol=tolerance,
        )  # fmt: skip
        return Run(solution.y, solution.nfev, solution.nexp)

    return solve


def _with_products(solve: Solve) -> Solve:
    """Return a solver on `LinearAction` that counts products of matrices in place of flows."""

    def counting(tolerance: float) -> Run:
        before = _core_r64.linear_products()
        run = solve(tolerance)
        return replace(run, flows=_core_r64.linear_products() - before)

    return counting


def _with_evaluations(solve: Solve) -> Solve:
    """Return a solver whose evaluations are its products."""

    def counting(tolerance: float) -> Run:
        run = solve(tolerance)
        return replace(run, flows=run.evaluations)

    return counting


def _curve(problem: LinearCase, name: str, solve: Solve, settings: Iterable[float]) -> Curve:
    """Run a solver with all tolerances, unless a run takes too long."""
    points = []
    for setting in settings:
        begin = time.process_time()
        solution = solve(setting)
        seconds = time.process_time() - begin
        points.append(Point.of(problem.case, solution, seconds))
        if seconds > _SLOWEST:
            break
    return Curve.of(name, "pair", 0, points)


def _work_rows(problem: LinearCase, quick: bool) -> list[Row]:
    case, settings = problem.case, tolerances(quick)
    curve = partial(_curve, problem, settings=settings)
    candidates = [
        solver
        for solver in pairs(case, tuple(settings))
        if solver.order >= _MIN_ORDER and (solver.kind == "pair" or has_brackets(case.frame))
    ]
    if isinstance(case.frame, LinearAction):
        here = [[curve("auto", _with_products(linear_solver(problem, "auto")))]]
        best = [curve(solver.name, _with_products(solver.solve)) for solver in candidates]
        there = [best, [curve(_SCIPY, _with_evaluations(dop853(problem)))]]
    else:
        names = [
            name
            for name, method in cg.methods.items()
            if isinstance(method, cg.MagnusMethod) and method.embedded_order is not None
        ]
        kaas = [solver.name for solver in candidates if solver.kind == "rkmk"]
        here = [[curve(n, linear_solver(problem, n)) for n in group] for group in (names, kaas)]
        there = [[curve(solver.name, solver.solve) for solver in candidates]]
    flows = "products" if isinstance(case.frame, LinearAction) else "exponentials"
    rows = []
    for quantity, unit in (("flows", flows), ("evaluations", "evaluations")):
        for error, own, others in product(_ERRORS, here, there):
            least, name = _least(own, error, quantity)
            work, other = _least(others, error, quantity)
            aim = Aim(3.0, above=True) if quantity == "flows" and others is there[0] else None
            what = f"{case.title}, error {error:g}, {name}"
            if not math.isnan(least + work):
                rows.append(Row(what, least, unit, other, work, work / least, aim=aim))
    return rows


def _least(curves: Iterable[Curve], error: float, quantity: str) -> tuple[float, str]:
    """Return the least work and the name of the method that needs it; NaN if none gets there."""
    work = [(curve.at(error, quantity), f"`{curve.name}`") for curve in curves]
    return min(((x, name) for x, name in work if not math.isnan(x)), default=(math.nan, ""))


def _time_rows(problem: LinearCase, rounds: int, quick: bool) -> list[Row]:
    case = problem.case
    solve: dict[str, Callable[[float], Run]] = {
        _OWN: linear_solver(problem, "auto"), _IVP: _solve_ivp(problem), _SCIPY: dop853(problem),
    }  # fmt: skip
    if with_qutip() and problem.hamiltonians is not None:
        solve[_QUTIP] = qutip_solver(problem)
    points: dict[str, list[Point]] = {name: [] for name in solve}
    for setting in tolerances(quick):
        calls = {name: partial(one, setting) for name, one in solve.items()}
        times = measure(calls, rounds=rounds, seconds=0.02)
        for name, call in calls.items():
            points[name].append(Point.of(case, call(), times.median(name)))
    curves = {name: Curve.of(name, "rival", 0, points[name]) for name in solve}
    own, rows = curves.pop(_OWN), []
    for name, curve in curves.items():
        aim = 1.0 if name == _IVP else 2.0
        for error in _ERRORS:
            here, there = (1e3 * c.at(error, "time") for c in (own, curve))
            if not math.isnan(here + there):
                what = f"{case.title}, error {error:g}"
                rows.append(
                    Row(what, here, "ms", name, there, there / here, aim=Aim(aim, above=True))
                )
    return rows


def _solve_ivp(problem: LinearCase) -> Solve:
    case = problem.case

    def solve(tolerance: float) -> Run:
        solution = cg.solve_ivp(
            case.f, (0.0, case.end), case.y0, frame=case.frame, rtol=tolerance, atol=tolerance
        )
        return Run(solution.y, solution.nfev, solution.nexp)

    return solve
