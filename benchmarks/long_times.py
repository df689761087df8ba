"""Energy, momenta, areas and reversibility over thousands of turns, beside other solvers."""

from __future__ import annotations

import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing
from scipy.integrate import solve_ivp

import cg
from reproduce.markdown import replace_between, table

from .cases import GALLERY
from .record import Figure, Result
from .rival_figure import dress, save_figure

TITLE = "Long times"
NAMES = ("asymmetric_top", "gravity_gradient", "water", "spins")
SPLITTING = {"BlanesMoan6": 9, "BlanesMoan4": 16, "Leapfrog": 100}
MIDPOINTS = {"DICG6": 40, "DICG4c": 20, "ImplicitMidpoint": 40}
RK4, TOLERANCE = 25, 1e-8
HEADS = ("", "method", "evaluations per turn", "energy, first tenth", "last tenth", "momenta",
         "areas", "reversed")  # fmt: skip


def method_text(turns: int) -> str:
    """Return how errors are measured."""
    steps = ", ".join(f"`{name}` {count}" for name, count in (SPLITTING | MIDPOINTS).items())
    return (
        f"Largest errors in {turns} turns, seen once a turn: of the energy in the first and in the "
        "last tenth of the time, and of momenta that symmetries conserve. Areas: by how much one "
        "turn changes Poisson brackets of coordinates, from differences of fourth order. Reversed: "
        f"the distance from the start after twenty turns forward and back. Steps per turn: {steps} "
        f"(midpoints in the ambient space of spins), RK4 with projection after each step {RK4}. "
        f"The default and SciPy's DOP853 have tolerances of {TOLERANCE:g}."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Measure all methods on all problems, and draw the errors of the energy."""
    turns, longest = (50, 100) if quick else (1000, 100_000)
    rows: list[list[str]] = []
    far: list[list[str]] = []
    drawing = Drawing(figsize=(11, 6.5), layout="constrained")
    for name, axes in zip(NAMES, drawing.subplots(2, 2).flat, strict=True):
        problem = SimpleNamespace(**runpy.run_path(str(GALLERY / f"{name}.py")))
        problem.steps = MIDPOINTS if hasattr(problem, "ambient") else SPLITTING
        title = name.replace("_", " ")
        dress(axes, title, "turns", "largest energy error so far")
        for method in [*problem.steps, "the default", "RK4, projected", "SciPy's DOP853"]:
            cells, change = _errors(problem, method, turns)
            rows.append([title, method, *cells, *_structure(problem, method)])
            axes.plot(np.arange(1, turns + 1), np.maximum.accumulate(change)[1:], label=method)
            if name in NAMES[:2] and method in ("BlanesMoan6", "the default"):
                far.append([title, method, *_errors(problem, method, longest)[0]])
        axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
    if figures is not None:
        save_figure(drawing, figures / "long_times.png", dpi=90)
    notes = table(HEADS, rows), f"In {longest:,} turns:", table(HEADS[:6], far)
    drawn = (Figure("long_times", f"Errors of the energy in {turns} turns"),)
    return Result(TITLE, method_text(turns), (), notes, drawn)


def write_table(result: Result, page: Path) -> None:
    """Write the tables between the marks of a page."""
    shown = "\n\n".join(result.notes) + "\n"
    replace_between(page, "<!-- long times -->\n", "<!-- end of long times -->\n", shown)


def _errors(problem: Any, method: str, turns: int) -> tuple[list[str], Any]:
    """Return the cells of a row, and the errors of the energy turn by turn."""
    y, evaluations = _solve(problem, method, problem.TURN * np.arange(turns + 1), problem.y0)
    energy, *momenta = problem.invariants(y).values()
    change, tenth = np.abs(energy - energy[0]), turns // 10
    lost = max(np.abs(momentum - momentum[0]).max() for momentum in momenta)
    sizes = change[: tenth + 1].max(), change[-tenth:].max(), lost
    return [f"{evaluations / turns:.0f}", *(f"{size:.1e}" for size in sizes)], change


def _structure(problem: Any, method: str) -> list[str]:
    """Return by how much one turn changes Poisson brackets, and twenty turns and back the point."""
    frame, d, times = problem.frame, 2e-3, problem.TURN * np.arange(21)

    def end(v: Any) -> Any:
        return _solve(problem, method, times[:2], frame.flow(v, problem.y0))[0][-1]

    after, weights = end(np.zeros(frame.dim)), {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    columns = [
        sum(w / d * frame.exp_coordinates(after, end(k * d * v)) for k, w in weights.items())
        for v in np.eye(frame.dim)
    ]
    moved = np.transpose(columns) @ _poisson(frame, problem.y0) @ columns
    there = _solve(problem, method, times, problem.y0)[0][-1]
    back = _solve(problem, method, times[::-1], there)[0][-1]
    changes = moved - _poisson(frame, after), back - problem.y0
    return [f"{np.abs(change).max():.1e}" for change in changes]


def _poisson(frame: Any, y: Any) -> Any:
    """Return the brackets of coordinates of the frame at a point, of spins up to their sign."""
    inner = getattr(frame, "configuration", frame)
    n = inner.dim
    unit = np.eye(n)
    turned = inner.bracket(unit[:, None], unit) @ y.ravel()[-n:]
    return turned if inner is frame else np.block([[0 * unit, unit], [-unit, turned]])


def _solve(problem: Any, method: str, times: Any, y0: Any) -> tuple[Any, int]:
    """Return the points at equidistant times, and the number of evaluations."""
    frame, f, span = problem.frame, problem.f, (times[0], times[-1])
    options: dict[str, Any] = {"rtol": TOLERANCE, "atol": TOLERANCE}
    if method in problem.steps or method == "the default":
        if method in problem.steps:
            options = {"method": method, "h": problem.TURN / problem.steps[method]}
            if hasattr(problem, "ambient"):
                frame, f = problem.ambient, problem.in_ambient_space
        start = y0.reshape(frame.point_shape)
        run = cg.solve_ivp(f, span, start, frame=frame, t_eval=times, **options)
        return run.y.reshape(-1, *y0.shape), run.nfev

    def tangent(t: float, y: Any) -> Any:
        v = np.asarray(f(t, y))
        return frame.field(frame.complete_rhs(v, y) if hasattr(frame, "inertia") else v, y)

    if method == "SciPy's DOP853":
        solution = solve_ivp(
            lambda t, y: tangent(t, y.reshape(y0.shape)).ravel(), span, y0.ravel(),
            method="DOP853", t_eval=times, **options,
        )  # fmt: skip
        return solution.y.T.reshape(-1, *y0.shape), solution.nfev
    points, h = [y0], (times[1] - times[0]) / RK4
    for t in np.linspace(*span, RK4 * (len(times) - 1) + 1)[:-1]:
        y, k, slope = points[-1], np.zeros(y0.shape), np.zeros(y0.shape)
        for c, b in ((0.0, 1 / 6), (0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6)):
            k = tangent(t + c * h, y + c * h * k)
            slope = slope + b * k
        points.append(frame.project(y + h * slope))
    return np.array(points[::RK4]), 4 * (len(points) - 1)
