"""All methods and other solvers on ten problems: error against work."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import median

import cg
from reproduce.markdown import table

from .cases import Case, cases, top_in_c
from .lielab_rival import expresses
from .lielab_top import available
from .record import Aim, Figure, Result, Row
from .rival_figure import draw
from .solvers import Run, Solver, solvers
from .work_curves import QUANTITIES, Curve, Point

_ERRORS = (1e-4, 1e-8, 1e-11)
_QUICK = ("heavy_top", "two_levels")
_DEFAULT = "default of solve_ivp"
_PROJECTED = "DOP853, projected"
_LONG = 0.5  # seconds; longer runs are timed once
_SLOWEST = 2.0  # seconds; after a longer run finer settings are left out


TITLE = "Comparison with other solvers"


def method_text(rounds: int) -> str:
    """Return how solvers are compared."""
    return (
        "All explicit pairs, methods of order four and higher with fixed steps, Munthe-Kaas "
        "methods, Magnus methods where the equation is linear, Lielab where it is applicable, and "
        "SciPy's DOP853 with projection after each step solve ten problems, with the same "
        "right-hand side in Python, for tolerances from 1e-3 to 1e-13 or as many step sizes. Work "
        f"for a given error at the end is interpolated. Times are medians of {rounds} rounds of "
        f"all solvers in turn, of one round for runs longer than {_LONG:g} s; after a run longer "
        f"than {_SLOWEST:g} s smaller tolerances are left out."
    )


DETAILS = (
    "For each problem the work and time of the solvers that are best in some column and of all "
    "competitors, for three errors at the end, and the largest distance from the manifold (drift)."
)


def run(quick: bool, figures: Path | None, only: Sequence[str] = ()) -> Result:
    """Run all solvers with many settings on all problems, or on the named ones."""
    rounds = 1 if quick else 3
    rows: list[Row] = []
    tables: list[str] = []
    drawn: list[Figure] = []
    wins: dict[str, list[int]] = {}
    problems = cases(only or (_QUICK if quick else None))
    with tempfile.TemporaryDirectory() as folder:
        problems += [top_in_c(c, Path(folder)) for c in problems if c.name == "heavy_top"]
        contests = [(case, _contest(case, rounds, quick)) for case in problems]
    for case, curves in contests:
        rows += _rows(case, curves)
        tables.append(_table(case, curves))
        _count(curves, wins)
        if figures is not None:
            draw(curves, case.title, f"rivals_{case.name}", figures)
        caption = (
            f"{case.title[0].upper()}{case.title[1:]}, t = 0 … {case.end:g}: error at the end "
            "against evaluations, flows and processor time, and the drift off the manifold."
        )
        drawn.append(Figure(f"rivals_{case.name}", caption))
    details = Result(TITLE, DETAILS, tuple(rows), tuple(tables), tuple(drawn[1:]))
    return Result(
        TITLE, method_text(rounds), (),
        (ratios_of_default(rows), f"{verdict(wins)}\n{_lielab(problems)}"),
        tuple(drawn[:1]), details,
    )  # fmt: skip


def ratios_of_default(rows: Sequence[Row]) -> str:
    """Return the table of the time of projected DOP853 divided by that of the default method."""
    errors = (1e-6, *_ERRORS[1:])
    by_title: dict[str, dict[str, str]] = {}
    for row in rows:
        title, separator, error = row.quantity.partition(f", {_DEFAULT}, error ")
        if separator and row.ratio is not None:
            by_title.setdefault(title, {})[error] = f"{row.ratio:.3g}"
    heads = [f"{error:g}" for error in errors]
    lines = [
        [title, *(ratios.get(head, "") for head in heads)] for title, ratios in by_title.items()
    ]
    return (
        "Time of SciPy's DOP853 with projection divided by the time of the default method of "
        f"`cg.solve_ivp`, by error at the end:\n\n{table(['', *heads], lines)}"
    )


def _lielab(problems: list[Case]) -> str:
    """Return which problems Lielab solves."""
    if not available():
        return "- Lielab was not installed, so there is no comparison with it."
    without = "; ".join(case.title for case in problems if not expresses(case))
    return (
        "- Lielab's Munthe-Kaas methods with adaptive steps, its fastest, do not count flows, and "
        "call functions in Python only. Lielab has no quaternions, no conjugation and no arrays of "
        f"groups, so it does not solve: {without}."
    )


def _contest(case: Case, rounds: int, quick: bool) -> list[Curve]:
    """Run all solvers that can call the right-hand side, in turns."""
    called = [s for s in solvers(case, quick) if callable(case.f) or s.kind != "rival"]
    tried = [_runs(case, solver) for solver in called]
    for _ in range(rounds - 1):
        for solver, runs in zip(called, tried, strict=True):
            _run_again(solver, runs)
    return [
        Curve.of(
            solver.name, solver.kind, solver.order,
            [replace(point, seconds=median(seconds)) for point, seconds in runs.values()],
        )
        for solver, runs in zip(called, tried, strict=True)
    ]  # fmt: skip


def _run_again(solver: Solver, runs: dict[float, tuple[Point, list[float]]]) -> None:
    """Add the times of another round, unless they are long."""
    for setting, (_, seconds) in runs.items():
        if seconds[0] <= _LONG:
            seconds.append(_timed(solver, setting)[1])


def _timed(solver: Solver, setting: float) -> tuple[Run, float]:
    begin = time.process_time()
    result = solver.solve(setting)
    return result, time.process_time() - begin


def _runs(case: Case, solver: Solver) -> dict[float, tuple[Point, list[float]]]:
    """Run a solver once with each of its settings; return results and lists of times."""
    runs: dict[float, tuple[Point, list[float]]] = {}
    for setting in solver.settings:
        try:
            result, seconds = _timed(solver, setting)
        except (ArithmeticError, RuntimeError, ValueError, cg.ConvergenceError) as failure:
            if isinstance(failure, ValueError) and "finite" not in str(failure):
                raise
            continue  # the step is too long for this method
        runs[setting] = Point.of(case, result, seconds), [seconds]
        if seconds > _SLOWEST:
            break
    return runs


def _best(curves: list[Curve], kinds: tuple[str, ...], error: float, quantity: str) -> str | None:
    """Return the name of the solver of the given kinds that needs least."""
    reached = [(c.at(error, quantity), c.name) for c in curves if c.kind in kinds]
    return min((pair for pair in reached if not math.isnan(pair[0])), default=(0.0, None))[1]


def _rows(case: Case, curves: list[Curve]) -> list[Row]:
    """Return the comparisons that have an aim."""
    by_name = {curve.name: curve for curve in curves}
    rows: list[Row] = []

    def compare(name: str | None, other: str, quantity: str, error: float, aim: float) -> None:
        if name in by_name and other in by_name:
            row = _row(case, by_name[name], by_name[other], quantity, error, aim)
            rows.extend([] if row is None else [row])

    fastest = _best(curves, ("pair", "fixed"), 1e-8, "time")
    compare(fastest, _PROJECTED, "time", 1e-8, 3.0 if case.name == "heavy_top" else 1.0)
    for error in (1e-6, *_ERRORS[1:]):
        compare(_DEFAULT, _PROJECTED, "time", error, 1.0)
    fewest = _best(curves, ("pair", "fixed"), 1e-8, "flows")
    compare(fewest, "RKMK4", "flows", 1e-8, 1.0)
    for error in _ERRORS[1:]:
        least = _best(curves, ("pair", "fixed"), error, "evaluations")
        for other in ("RKMK8(5,3)", _PROJECTED):
            compare(least, other, "evaluations", error, 1.0)
    return rows


def _row(
    case: Case, curve: Curve, other: Curve, quantity: str, error: float, aim: float
) -> Row | None:
    work, against = curve.at(error, quantity), other.at(error, quantity)
    if math.isnan(work) or math.isnan(against):
        return None
    scale, unit = (1e3, "ms") if quantity == "time" else (1.0, quantity)
    what = f"{case.title}, {curve.name}, error {error:g}"
    here, there, ratio = scale * work, scale * against, against / work
    return Row(what, here, unit, other.name, there, ratio, aim=Aim(aim, True))


def _count(curves: list[Curve], wins: dict[str, list[int]]) -> None:
    """Count for how many errors a method of the catalogue needs less than all other solvers."""
    for quantity in QUANTITIES:
        for error in _ERRORS:
            own_best = _best(curves, ("pair", "fixed"), error, quantity)
            best = _best(curves, ("pair", "fixed", "rkmk", "rival"), error, quantity)
            if best is not None:
                counts = wins.setdefault(quantity, [0, 0])
                counts[0] += own_best == best
                counts[1] += 1


def verdict(wins: Mapping[str, Sequence[int]]) -> str:
    """Return in how many cases a method of the catalogue needs least, by quantity."""
    counts = ", ".join(f"{quantity} in {count}" for quantity, (count, _) in wins.items())
    total = max((total for _, total in wins.values()), default=0)
    return (
        f"- Of {total} cases (a problem and an error) a Crouch–Grossman or commutator-free method "
        f"of the catalogue needs the least {counts}; in the others a Munthe-Kaas method or another "
        "package does."
    )


def _cell(curve: Curve, error: float, quantity: str) -> str:
    work = curve.at(error, quantity) * (1e3 if quantity == "time" else 1.0)
    return "" if math.isnan(work) else f"{work:.3g}"


def _table(case: Case, curves: list[Curve]) -> str:
    """Return a table of the best solvers of each kind and of all competitors."""
    by_name = {curve.name: curve for curve in curves}
    wanted = product((("pair",), ("fixed",)), QUANTITIES, _ERRORS)
    best = [_best(curves, kinds, error, quantity) for kinds, quantity, error in wanted]
    always = [name for name in (_DEFAULT, "DP5(4)", "DOP853", "CF4") if name in by_name]
    selected = dict.fromkeys(name for name in (*best, *always) if name is not None)
    rivals = [curve.name for curve in curves if curve.kind in ("rkmk", "rival")]
    heads = [f"{quantity}, {error:g}" for error in _ERRORS for quantity in QUANTITIES]
    rows = []
    for name in (*selected, *rivals):
        curve = by_name[name]
        cells = [_cell(curve, *what) for what in product(_ERRORS, QUANTITIES)]
        if any(cells):
            drift = curve.drift(_ERRORS[1])
            cells.append("" if math.isnan(drift) else f"{drift:.0e}")
            label = f"`{name}`" if curve.kind in ("pair", "fixed", "rkmk") else name
            rows.append([label, *cells])
    title = f"**{case.title[0].upper()}{case.title[1:]}**, t = 0 … {case.end:g}; time in ms:"
    return f"{title}\n\n{table(['', *heads, 'drift'], rows)}"
