"""The default of `cg.solve_ivp` and SciPy's DOP853 with projection on ten problems."""

from __future__ import annotations

import math

from reproduce.markdown import table

from .cases import Case, cases
from .record import Result
from .solvers import adaptive, dop853
from .work_curves import run_curves

_ERRORS = (1e-6, 1e-8, 1e-11)
_QUICK = ("heavy_top", "two_levels")

TITLE = "Comparison with other solvers"


def method_text(rounds: int) -> str:
    """Return how solvers are compared."""
    return (
        "The default method of `cg.solve_ivp` and SciPy's DOP853 with projection after each step "
        "solve ten problems, with the same right-hand side in Python, for tolerances from 1e-3 to "
        "1e-13. Work for a given error at the end is interpolated. Times are medians of "
        f"{rounds} rounds of both in turn."
    )


def run(quick: bool) -> Result:
    """Run both solvers with many tolerances on all problems."""
    rounds = 1 if quick else 3
    tolerances = [10.0**-k for k in range(3, 9 if quick else 14)]
    ratios = {
        case.title: compare(case, tolerances, rounds) for case in cases(_QUICK if quick else None)
    }
    rows = [[title, *map(_cell, numbers)] for title, numbers in ratios.items()]
    note = (
        "Time of SciPy's DOP853 with projection divided by the time of the default method of "
        f"`cg.solve_ivp`, by error at the end:\n\n{table(['', *map('{:g}'.format, _ERRORS)], rows)}"
    )
    return Result(TITLE, method_text(rounds), (), (note,), {"ratios": ratios})


def compare(case: Case, tolerances: list[float], rounds: int) -> list[float | None]:
    """Return the time of DOP853 divided by that of the default, for each error."""
    curves = run_curves(
        case, {"default": adaptive(case), "DOP853": dop853(case)}, tolerances, rounds
    )
    ratios = [
        curves["DOP853"].at(error, "time") / curves["default"].at(error, "time")
        for error in _ERRORS
    ]
    return [None if math.isnan(ratio) else ratio for ratio in ratios]


def _cell(ratio: float | None) -> str:
    return "" if ratio is None else f"{ratio:.3g}"
