"""Work-precision figures for the pages of methods, computed when the site is built.

All methods take equal steps with about the same numbers of evaluations, so that curves cover the
same range. The curves for comparison are computed once per build.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot
from matplotlib.ticker import NullLocator

import cg
from cg.construction.catalogue import resolve_method
from cg.construction.methods.method import Method

TO_COMPARE = ("CG4a", "DOP853", "CF4")
"""Methods for comparison; the third replaces one of the others on its own page."""

LINEAR_TO_COMPARE = ("CFM4", "CFM8(4)", "CFM6(4)")
"""Those for Magnus methods."""

END = 2
EVALUATIONS = tuple(100 * 2**k for k in range(6))
SOLVES = 6  # factor of evaluations for solving the stage equations of an implicit method
BITS = 80
ROUNDING = 1e-14  # the exact solutions are rounded to double precision


@dataclass(frozen=True)
class Work:
    """A problem on which methods are compared.

    Attributes
    ----------
    title : str
    link : str
        The title, or a link in MyST.
    solve : callable
        ``solve(method, h)`` returns a solution.
    exact : callable
        Returns the solution at the end.
    frame : Frame
    end : float
    """

    title: str
    link: str
    solve: Callable[[Method, float], Any]
    exact: Callable[[], np.ndarray]
    frame: cg.frames.Frame
    end: float


def _nonlinear(title: str, name: str) -> Work:
    case = getattr(cg.problems, name)()

    def solve(method: Method, h: float) -> Any:
        return cg.integrate(case.f, (0, END), case.y0, frame=case.frame, method=method, h=h)

    def exact() -> np.ndarray:
        """Return the solution by Taylor series in extended precision."""
        return case.reference([Fraction(END)], bits=BITS).y[-1]

    link = f"[{title}](../reference/generated/cg.problems.{name}.rst)"
    return Work(title, link, solve, exact, case.frame, END)


def _linear(
    title: str, frame: cg.frames.Frame, a: Callable[[float], list[float]], y0: Any, end: float
) -> Work:
    def solve(method: Method | str, h: float) -> Any:
        return cg.solve_linear(a, (0, end), y0, frame=frame, method=method, h=h)

    def exact() -> np.ndarray:
        """Return the solution with steps so short that only rounding is left."""
        return solve("CFM8(4)", 0.005).y[-1]

    return Work(title, title, solve, exact, frame, end)


def _drive(t: float) -> list[float]:
    return [math.cos(4.0 * t), 0.0, 4.0]


def _rates(t: float) -> list[float]:
    return [math.sin(t), math.cos(2.0 * t), 1.0 + 0.5 * math.sin(3.0 * t)]


@cache
def problems(linear: bool) -> dict[str, Work]:
    """Return the problems by the names of their pictures."""
    if linear:
        spin, turning = cg.frames.SU(2), cg.frames.UnitQuaternion()
        identity, one = np.eye(2, dtype=complex), [0.0, 0.0, 0.0, 1.0]
        return {
            "linear_0": _linear("driven two-level system", spin, _drive, identity, 20),
            "linear_1": _linear("prescribed rotation", turning, _rates, one, 10),
        }
    return {
        "heavy_top": _nonlinear("heavy top", "HeavyTop"),
        "free_body": _nonlinear("free rigid body", "FreeRigidBody"),
    }


@cache
def exact(problem: Work) -> np.ndarray:
    """Return the solution of a problem at the end."""
    return problem.exact()


def measured(problem: Work, method: Method) -> list[tuple[int, int, float]]:
    """Return evaluations, flows and error at the end for decreasing step sizes."""
    points = []
    for evaluations in EVALUATIONS:
        a_step = method.stages * (1 if method.explicit else SOLVES)
        steps = max(1, round(evaluations / a_step))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # CG6a's order is nominal
            try:
                run = problem.solve(method, problem.end / steps)
            except (cg.ConvergenceError, OverflowError):
                continue
        error = float(problem.frame.distance(run.y[-1], exact(problem)))
        if error > ROUNDING and np.isfinite(error):
            points.append((run.nfev, run.nexp, error))
    return points


@cache
def to_compare(problem: Work, name: str) -> list[tuple[int, int, float]]:
    """Return the result of `measured` for a method of comparison."""
    return measured(problem, resolve_method(name))


def others(method: Method) -> list[str]:
    """Return the names of the methods that a method is compared with."""
    names = LINEAR_TO_COMPARE if isinstance(method, cg.MagnusMethod) else TO_COMPARE
    return [name for name in names if name != method.name][:2]


def draw(path: Path, problem: Work, method: Method) -> None:
    """Draw the error against evaluations and flows of a method and two others."""
    curves = {method.name: measured(problem, method)}
    curves |= {name: to_compare(problem, name) for name in others(method)}
    figure, (above, below) = pyplot.subplots(2, 1, figsize=(4.0, 5.9), sharey=True)
    # fixed, since automatic layout would take twice as long
    figure.subplots_adjust(left=0.19, right=0.97, bottom=0.085, top=0.95, hspace=0.36)
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
    above.set_title(problem.title, fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=180)
    pyplot.close(figure)


def section(folder: Path, file: str, method: Method) -> str:
    """Draw the figures of a method into a folder, and return the section of its page."""
    here = problems(isinstance(method, cg.MagnusMethod))
    pictures = []
    for name, problem in here.items():
        path = folder / "pictures" / f"{file}_{name}.png"
        draw(path, problem, method)
        words = f"Error of {method.name} over evaluations and flows: {problem.title}"
        pictures.append(f"![{words}](pictures/{path.name}){{.half}}")
    links = " and a ".join(problem.link for problem in here.values())
    ends = dict.fromkeys(f"{problem.end:g}" for problem in here.values())
    return (
        f"## Work and precision\n\nThe error at t = {' and '.join(ends)} with fixed steps, "
        f"as a distance on the manifold, against the work, compared with "
        f"{' and '.join(others(method))}, on a {links}. Errors below {ROUNDING:g} are rounding "
        "errors, and left out.\n\n" + "\n".join(pictures)
    )


def parts() -> list[Any]:
    """Return the modules on which the figures depend."""
    return [cg.plot.errors, cg.problems.rigid_body]
