"""The same tableau as a lifted commutator-free method and as a Munthe-Kaas method."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np

from cg.formats.markdown import table
from cg.frames import SE3
from cg.problems.affine import AffineField

from .cases import Case, cases, top_in_c
from .record import Result
from .solvers import solvers
from .work_curves import QUANTITIES, Curve, run_curves

_PAIRS = {"DP5(4)": "RKMK5(4)", "DOP853": "RKMK8(5,3)"}
_CASES = ("heavy_top", "fast_torque", "gradient_flow", "toda")
_ERRORS = (1e-5, 1e-8, 1e-11)

TITLE = "One tableau, lifted and with dexp⁻¹"


def method_text(rounds: int) -> str:
    """Return how both forms are measured."""
    return (
        "The tableaux of Dormand and Prince's 5(4) and Hairer's DOP853, lifted to commutator-free "
        "methods (`DP5(4)`, `DOP853`) and as Munthe-Kaas methods (`RKMK5(4)`, `RKMK8(5,3)`), with "
        "the same step-size controller, `f` in Python except for the last problem, and tolerances "
        "from 1e-3 to 1e-13. dexp⁻¹ has a closed form on SO(3) and SE(3), and is a series on SU(3) "
        "and in Toda's flow. Work for a given error at the end is interpolated; times are medians "
        f"of {rounds} rounds in turns."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Run both forms of both tableaux on groups with and without a closed form of dexp⁻¹."""
    rounds = 1 if quick else 5
    problems = cases(["heavy_top"] if quick else _CASES)
    problems.insert(len(problems) - 2 if not quick else 1, _motion())
    header = ("", "tableau", "error", "evaluations", "", "flows", "", "time, ms", "", "")
    rows = [["", "", "", *["lifted", "dexp⁻¹"] * 3, "ratio"]]
    won = dict.fromkeys(QUANTITIES, 0)
    contests = 0
    with tempfile.TemporaryDirectory() as folder:
        problems.append(top_in_c(problems[0], Path(folder)))
        for case in problems:
            curves = _curves(case, rounds, quick)
            for lifted, algebra in _PAIRS.items():
                for error in _ERRORS:
                    line = _line(case, curves[lifted], curves[algebra], error, won)
                    contests += line is not None
                    rows += [] if line is None else [line]
    counts = ", ".join(
        f"{'less' if quantity == 'time' else 'fewer'} {quantity} in {count}"
        for quantity, count in won.items()
    )
    verdict = (
        f"- In {contests} cases (a problem, a tableau, an error) the lifted method needs {counts}; "
        "in the others the method with dexp⁻¹ needs less."
    )
    explanation = (
        "The ratio is the time of the method with dexp⁻¹ divided by that of the lifted one: above "
        "1 the lifted one is faster."
    )
    details = Result(TITLE, explanation, (), (table(header, rows),))
    return Result(TITLE, method_text(rounds), (), (verdict,), details=details)


def _motion() -> Case:
    problem = AffineField(SE3("space"), np.eye(4), seed=3)
    exact = np.array(problem.reference([1.0], bits=96).y)[0][:-1].reshape(4, 4)
    title = "affine field on SE(3)"
    return Case("motion", title, problem.frame, problem.f, problem.y0, 1.0, exact)


def _curves(case: Case, rounds: int, quick: bool) -> dict[str, Curve]:
    """Return error against work of all four methods, which run in turns."""
    names = {*_PAIRS, *_PAIRS.values()}
    chosen = [solver for solver in solvers(case, quick) if solver.name in names]
    solve = {solver.name: solver.solve for solver in chosen}
    return run_curves(case, solve, chosen[0].settings, rounds)


def _line(
    case: Case, lifted: Curve, algebra: Curve, error: float, won: dict[str, int]
) -> list[str] | None:
    cells = []
    for quantity in QUANTITIES:
        one, other = lifted.at(error, quantity), algebra.at(error, quantity)
        if math.isnan(one) or math.isnan(other):
            return None
        scale = 1e3 if quantity == "time" else 1.0
        cells += [f"{scale * one:.3g}", f"{scale * other:.3g}"]
        if quantity == "time":
            cells.append(f"{other / one:.2f}")
    for quantity in QUANTITIES:
        won[quantity] += lifted.at(error, quantity) < algebra.at(error, quantity)
    title = f"{case.title[0].upper()}{case.title[1:]}"
    return [title, algebra.name[4:], f"{error:g}", *cells]
