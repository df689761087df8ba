"""Energy, momentum, areas and reversibility over thousands of turns, beside other solvers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import cg
from cg.frames import Frame, PhaseSpace
from reproduce.markdown import replace_between, table

from .long_problems import Problem, molecules, satellite, spins, top
from .record import Figure, Result
from .rival_figure import save_panels

TITLE = "Long times"
BEGIN, END = "<!-- long times -->\n", "<!-- end of long times -->\n"
TURNS, MORE_TURNS = 2000, 100_000
TOLERANCE = 1e-8
_HEADS = [
    "evaluations per turn", "energy, first tenth", "last tenth", "momentum", "areas", "reversed",
]  # fmt: skip
_SPLITTING = {"BlanesMoan6": 9, "BlanesMoan4": 16, "Leapfrog": 100}
_MIDPOINTS = {"DICG6": 8, "DICG4c": 10, "ImplicitMidpoint": 30}
_RK4 = 25
Way = Callable[[Any, Any], tuple[Any, int]]


def method_text(turns: int) -> str:
    """Return how errors are measured."""
    return (
        f"Largest errors over {turns} turns, seen once a turn: of the energy in the first and in the "
        "last tenth of the time, and of the momenta that symmetries conserve. Areas: by how much two "
        "turns change the Poisson brackets of coordinates, from differences of fourth order. "
        "Reversed: distance to the initial point after twenty turns forward and back. Steps of "
        f"{_steps()}; the default and SciPy's DOP853 with tolerances {TOLERANCE:g}; RK4 with "
        f"{_RK4} steps per turn and projection onto the manifold after each. Midpoint steps are in "
        "the ambient space."
    )


def _steps() -> str:
    steps = (_SPLITTING | _MIDPOINTS).items()
    return ", ".join(f"`{name}`: 1/{count}" for name, count in steps) + " turn"


def run(quick: bool, figures: Path | None) -> Result:
    """Measure all methods on all problems, and draw the errors of the energy."""
    turns, more = (50, 200) if quick else (TURNS, MORE_TURNS)
    rows, panels = [], []
    for problem in (top(), satellite(), molecules(2), spins()):
        curves = {}
        for name, way in _ways(problem).items():
            cells, curves[name] = _measure(problem, way, turns)
            rows.append([problem.name, name, *cells])
        panels.append((problem.name, curves))
    far = []
    for problem in (top(), satellite()):
        ways = _ways(problem)
        for name in ("BlanesMoan6", "the default"):
            far.append([problem.name, name, *_measure(problem, ways[name], more, brief=True)[0]])
    if figures is not None:
        save_panels(panels, figures / "long_times.png")
    notes = (
        table(["", "method", *_HEADS], rows),
        f"Over {more} turns:",
        table(["", "method", *_HEADS[:4]], far),
    )
    caption = "Errors of the energy, the largest up to each turn"
    return Result(TITLE, method_text(turns), (), notes, (Figure("long_times", caption),))


def write_table(result: Result, page: Path) -> None:
    """Write both tables into a page."""
    replace_between(page, BEGIN, END, "\n\n".join(result.notes) + "\n")


def _measure(problem: Problem, way: Way, turns: int, *, brief: bool = False) -> Any:
    """Return the cells of a row, and the errors of the energy by turns."""
    times = np.linspace(0.0, turns * problem.turn, min(turns, 2000) + 1)
    y, evaluations = way(times, problem.y0)
    energy = problem.energy(times, y)
    change = np.abs(energy - energy[0])
    tenth = len(times) // 10
    momentum = problem.momentum(y)
    cells = [
        f"{evaluations / turns:.0f}",
        f"{change[: tenth + 1].max():.1e}",
        f"{change[-tenth:].max():.1e}",
        "–" if momentum is None else f"{np.abs(momentum - momentum[0]).max():.1e}",
    ]
    if not brief:
        there, back = np.array([0.0, 20 * problem.turn]), np.array([20 * problem.turn, 0.0])
        end = way(back, way(there, problem.y0)[0][-1])[0][-1]
        distance = np.abs(end - problem.y0).max()
        cells += [f"{_area_defect(problem, way):.1e}", f"{distance:.1e}"]
    return cells, (times / problem.turn, change)


def _area_defect(problem: Problem, way: Way) -> float:
    """Return by how much two turns change the Poisson brackets, by differences."""
    frame, d = problem.frame, 2e-3
    times = np.array([0.0, 2 * problem.turn])
    after = way(times, problem.y0)[0][-1]

    def moved(v: Any) -> Any:
        return frame.exp_coordinates(after, way(times, frame.flow(v, problem.y0))[0][-1])

    weights = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    columns = [
        sum(weight * moved(k * d * v) for k, weight in weights.items()) / d
        for v in np.eye(frame.dim)
    ]
    change = np.transpose(columns) @ problem.poisson(problem.y0) @ np.array(columns)
    return float(np.abs(change - problem.poisson(after)).max())


def _ways(problem: Problem) -> dict[str, Way]:
    """Return the solvers: functions of output times and of the initial point."""
    splits = isinstance(problem.frame, PhaseSpace)
    ways: dict[str, Way] = {}
    for name, count in (_SPLITTING if splits else _MIDPOINTS).items():
        ways[name] = _own(problem, method=name, h=problem.turn / count)
    ways["the default"] = _own(problem, rtol=TOLERANCE, atol=TOLERANCE)
    return ways | {"RK4, projected": _projected(problem), "SciPy's DOP853": _scipy(problem)}


def _own(problem: Problem, **options: Any) -> Way:
    frame, f = problem.frame, problem.f
    if "h" in options and problem.ambient is not None:
        frame, f = problem.ambient

    def way(times: Any, y0: Any) -> tuple[Any, int]:
        start = y0.reshape(frame.point_shape)
        run = cg.solve_ivp(
            f, (times[0], times[-1]), start, frame=frame, t_eval=times, **options
        )
        return run.y.reshape(len(times), *y0.shape), run.nfev

    return way


def _tangent(problem: Problem) -> Callable[[float, Any], Any]:
    """Return the derivatives of the entries of a point."""
    frame = problem.frame

    def tangent(t: float, y: Any) -> Any:
        v = problem.f(t, y)
        if isinstance(frame, PhaseSpace):
            v = frame.complete_rhs(np.asarray(v), y)
        return frame.field(v, y)

    return tangent


def _projected(problem: Problem) -> Way:
    frame: Frame = problem.frame
    f = _tangent(problem)

    def way(times: Any, y0: Any) -> tuple[Any, int]:
        y, points = y0, [y0]
        steps = round(abs(times[1] - times[0]) / problem.turn * _RK4)
        h = (times[1] - times[0]) / steps
        for begin in times[:-1]:
            for t in begin + h * np.arange(steps):
                k1 = f(t, y)
                k2 = f(t + h / 2, y + h / 2 * k1)
                k3 = f(t + h / 2, y + h / 2 * k2)
                k4 = f(t + h, y + h * k3)
                y = frame.project(y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
            points.append(y)
        return np.array(points), 4 * steps * (len(times) - 1)

    return way


def _scipy(problem: Problem) -> Way:
    f = _tangent(problem)

    def way(times: Any, y0: Any) -> tuple[Any, int]:
        run = solve_ivp(
            lambda t, y: f(t, y.reshape(y0.shape)).ravel(), (times[0], times[-1]), y0.ravel(),
            method="DOP853", rtol=TOLERANCE, atol=TOLERANCE, t_eval=times,
        )  # fmt: skip
        return run.y.T.reshape(len(times), *y0.shape), run.nfev

    return way
