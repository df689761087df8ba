"""All methods against their strongest rivals, problem by problem: error against work."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

import cg

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
_LONG = 0.5  # seconds for a run that needs no other to be judged
_SLOWEST = 2.0  # after which finer settings are left out


def run(quick: bool, figures: Path | None, only: Sequence[str] = ()) -> Result:
    """Run all solvers with many settings on all problems, or on some by their names."""
    rounds = 1 if quick else 3
    rows: list[Row] = []
    notes: list[str] = []
    drawn: list[Figure] = []
    won: dict[str, list[int]] = {}
    found = cases(only or (_QUICK if quick else None))
    with tempfile.TemporaryDirectory() as folder:
        found += [top_in_c(case, Path(folder)) for case in found if case.name == "heavy_top"]
        contests = [(case, _contest(case, rounds, quick)) for case in found]
    for case, curves in contests:
        rows += _rows(case, curves)
        notes.append(_table(case, curves))
        _count(curves, won)
        if figures is not None:
            draw(curves, case.title, f"rivals_{case.name}", figures)
        caption = (
            f"{case.title[0].upper()}{case.title[1:]}, t = 0 … {case.end:g}: error at the end "
            "against evaluations, flows and processor time, and the drift off the manifold."
        )
        drawn.append(Figure(f"rivals_{case.name}", caption))
    notes.insert(0, f"{_verdicts(won)}\n{_lielab(found)}")
    return Result(
        "Rivals",
        "All explicit pairs and methods of order four and more, Munthe-Kaas methods, Magnus "
        "methods where the equation is linear, and SciPy's DOP853 with projection after each step, "
        "with the same right-hand side in Python, for tolerances from 1e-3 to 1e-13 or as many "
        f"step sizes. Numbers are for an error at the end, by interpolation; medians of {rounds} "
        f"rounds of all solvers in turn, of runs longer than {_LONG:g} s one; after one longer "
        f"than {_SLOWEST:g} s finer settings are left out.",
        tuple(rows),
        tuple(notes),
        tuple(drawn),
    )


def _lielab(found: list[Case]) -> str:
    """Say where Lielab takes part."""
    if not available():
        return "- Lielab was not installed, and is left out (`pip install lielab==0.5.2`)."
    without = ", ".join(case.title for case in found if not expresses(case))
    return (
        "- Lielab's methods of Munthe-Kaas, its fastest, with chosen steps: it counts no flows, "
        "and calls functions in Python only, with points as objects. It has no quaternions, no "
        f"conjugation and no arrays of groups, and is left out of: {without}."
    )


def _contest(case: Case, rounds: int, quick: bool) -> list[Curve]:
    """Run all solvers; a function in C is for those alone that call it from compiled code.

    A round is of all solvers, so that a machine that is slower for a while is so for all of them.
    """
    called = [s for s in solvers(case, quick) if callable(case.f) or s.kind != "rival"]
    tried = [_runs(case, solver) for solver in called]
    for _ in range(rounds - 1):
        for solver, runs in zip(called, tried, strict=True):
            for setting, (_, seconds) in runs.items():
                if seconds[0] <= _LONG:
                    seconds.append(_timed(solver, setting)[1])
    return [
        Curve.of(
            solver.name, solver.kind, solver.order,
            [replace(point, seconds=median(seconds)) for point, seconds in runs.values()],
        )
        for solver, runs in zip(called, tried, strict=True)
    ]  # fmt: skip


def _timed(solver: Solver, setting: float) -> tuple[Run, float]:
    begin = time.process_time()
    found = solver.solve(setting)
    return found, time.process_time() - begin


def _runs(case: Case, solver: Solver) -> dict[float, tuple[Point, list[float]]]:
    """Run a solver with each of its settings for the first time; return times of all rounds too."""
    runs: dict[float, tuple[Point, list[float]]] = {}
    for setting in solver.settings:
        try:
            found, seconds = _timed(solver, setting)
        except (ArithmeticError, RuntimeError, ValueError, cg.ConvergenceError) as failure:
            if isinstance(failure, ValueError) and "finite" not in str(failure):
                raise
            continue  # a step too long for it
        runs[setting] = Point.of(case, found, seconds), [seconds]
        if seconds > _SLOWEST:
            break
    return runs


def _best(curves: list[Curve], kinds: tuple[str, ...], error: float, quantity: str) -> str | None:
    """Return the name of the solver of some kinds that needs least."""
    reached = [(c.at(error, quantity), c.name) for c in curves if c.kind in kinds]
    return min((pair for pair in reached if not math.isnan(pair[0])), default=(0.0, None))[1]


def _rows(case: Case, curves: list[Curve]) -> list[Row]:
    """Compare with the rivals where an aim was set."""
    named = {curve.name: curve for curve in curves}
    rows: list[Row] = []

    def compare(name: str | None, other: str, quantity: str, error: float, aim: float) -> None:
        if name in named and other in named:
            row = _row(case, named[name], named[other], quantity, error, aim)
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
    case: Case, own: Curve, other: Curve, quantity: str, error: float, aim: float
) -> Row | None:
    work, against = own.at(error, quantity), other.at(error, quantity)
    if math.isnan(work) or math.isnan(against):
        return None
    scale, unit = (1e3, "ms") if quantity == "time" else (1.0, quantity)
    what = f"{case.title}, {own.name}, error {error:g}"
    here, there, ratio = scale * work, scale * against, against / work
    return Row(what, here, unit, other.name, there, ratio, aim=Aim(aim, True))


def _count(curves: list[Curve], won: dict[str, list[int]]) -> None:
    """Count at how many errors the best of the catalogue needs least of all solvers."""
    for quantity in QUANTITIES:
        for error in _ERRORS:
            own = _best(curves, ("pair", "fixed"), error, quantity)
            best = _best(curves, ("pair", "fixed", "rkmk", "rival"), error, quantity)
            if best is not None:
                counts = won.setdefault(quantity, [0, 0])
                counts[0] += own == best
                counts[1] += 1


def _verdicts(won: dict[str, list[int]]) -> str:
    lines = [
        f"- By {quantity} a method of the catalogue needs least in {count} of {total} contests "
        "(a problem and an error), and a rival in the others."
        for quantity, (count, total) in won.items()
    ]
    return "\n".join(lines)


def _table(case: Case, curves: list[Curve]) -> str:
    """Return a table of the best of each kind, and of all rivals."""
    named = {curve.name: curve for curve in curves}
    shown: dict[str, None] = {}
    for kinds in (("pair",), ("fixed",)):
        for quantity in QUANTITIES:
            for error in _ERRORS:
                best = _best(curves, kinds, error, quantity)
                if best is not None:
                    shown[best] = None
    for name in (_DEFAULT, "DP5(4)", "DOP853", "CF4"):
        if name in named:
            shown[name] = None
    rivals = [curve.name for curve in curves if curve.kind in ("rkmk", "rival")]
    heads = [f"{quantity}, {error:g}" for error in _ERRORS for quantity in QUANTITIES]
    lines = [
        f"**{case.title[0].upper()}{case.title[1:]}**, t = 0 … {case.end:g}; time in ms:",
        "",
        f"| | {' | '.join(heads)} | drift |",
        "|---" * (len(heads) + 2) + "|",
    ]
    for name in (*shown, *rivals):
        curve = named[name]
        cells = []
        for error in _ERRORS:
            for quantity in QUANTITIES:
                work = curve.at(error, quantity) * (1e3 if quantity == "time" else 1.0)
                cells.append("" if math.isnan(work) else f"{work:.3g}")
        if any(cells):
            drift = curve.drift(_ERRORS[1])
            cells.append("" if math.isnan(drift) else f"{drift:.0e}")
            label = f"`{name}`" if curve.kind in ("pair", "fixed", "rkmk") else name
            lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join(lines)
