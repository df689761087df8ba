"""Work-precision figures for the pages of methods, computed when the site is built.

All methods take equal steps with about the same numbers of evaluations, so that curves cover the
same range. The curves for comparison are computed once per build.
"""

from __future__ import annotations

import warnings
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot
from matplotlib.ticker import NullLocator

import cg
from cg.method.method import Method

TO_COMPARE = ("CG4a", "DOP853", "CF4")
"""Methods for comparison; the third replaces one of the others on its own page."""

PROBLEMS = {
    "heavy_top": ("heavy top", cg.problems.HeavyTop()),
    "free_body": ("free rigid body", cg.problems.FreeRigidBody()),
}
END = 2
EVALUATIONS = tuple(100 * 2**k for k in range(6))
SOLVES = 6  # factor of evaluations for solving the stage equations of an implicit method
BITS = 80
ROUNDING = 1e-14  # the exact solutions are rounded to double precision


@cache
def exact(problem: str) -> np.ndarray:
    """Return the solution of a problem at the end, by Taylor series in extended precision."""
    _, case = PROBLEMS[problem]
    return case.reference([Fraction(END)], bits=BITS).y[-1]


def measured(problem: str, method: Method) -> list[tuple[int, int, float]]:
    """Return evaluations, flows and error at the end for decreasing step sizes."""
    _, case = PROBLEMS[problem]
    points = []
    for evaluations in EVALUATIONS:
        a_step = method.stages * (1 if method.explicit else SOLVES)
        steps = max(1, round(evaluations / a_step))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # CG6a's order is nominal
            try:
                run = cg.integrate(
                    case.f, (0, END), case.y0, frame=case.frame, method=method, h=END / steps
                )
            except (cg.ConvergenceError, OverflowError):
                continue
        error = float(case.frame.distance(run.y[-1], exact(problem)))
        if error > ROUNDING and np.isfinite(error):
            points.append((run.nfev, run.nexp, error))
    return points


@cache
def to_compare(problem: str, name: str) -> list[tuple[int, int, float]]:
    """Return the result of `measured` for a method of comparison."""
    return measured(problem, cg.methods[name])


def draw(path: Path, problem: str, method: Method) -> None:
    """Draw the error against evaluations and flows of a method and two others."""
    others = [name for name in TO_COMPARE if name != method.name][:2]
    curves = {method.name: measured(problem, method)}
    curves |= {name: to_compare(problem, name) for name in others}
    figure, (above, below) = pyplot.subplots(2, 1, figsize=(4.0, 5.6), sharey=True)
    # fixed, since automatic layout would take twice as long
    figure.subplots_adjust(left=0.19, right=0.97, bottom=0.085, top=0.95, hspace=0.24)
    for ax, work, unit in ((above, 0, "evaluations of f"), (below, 1, "flows")):
        for name, points in curves.items():
            if points:
                label = name if ax is above else None
                cg.plot.work_precision(
                    [point[work] for point in points],
                    [point[2] for point in points],
                    ax,
                    label=label,
                    unit=unit,
                )
        ax.xaxis.set_minor_locator(NullLocator())
    above.set_title(PROBLEMS[problem][0], fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=180)
    pyplot.close(figure)


def section(folder: Path, file: str, method: Method) -> str:
    """Draw the figures of a method into a folder, and return the section of its page."""
    others = [name for name in TO_COMPARE if name != method.name][:2]
    pictures = []
    for problem, (title, _) in PROBLEMS.items():
        path = folder / "pictures" / f"{file}_{problem}.png"
        draw(path, problem, method)
        words = f"Error of {method.name} over evaluations and flows: {title}"
        pictures.append(f"![{words}](pictures/{path.name}){{.half}}")
    return (
        f"## Work and precision\n\nThe error at t = {END} with fixed steps, as a distance on the "
        f"manifold, against the work, compared with {others[0]} and {others[1]}: the "
        "[heavy top](../reference/generated/cg.problems.HeavyTop.rst) of the paper, and a "
        "[free rigid body](../reference/generated/cg.problems.FreeRigidBody.rst). Errors below "
        f"{ROUNDING:g} are rounding errors, and left out.\n\n" + "\n".join(pictures)
    )


def parts() -> list[Any]:
    """Return the modules on which the figures depend."""
    return [cg.plot.errors, cg.problems.heavy_top, cg.problems.free_rigid_body]
