"""The error between steps compared with the error at the steps, for all pairs."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cg
from cg.catalogue import methods
from cg.frames import Euclidean, Frame, Stiefel
from cg.integration import Solution
from cg.problems import HeavyTop

from .output_figure import OutputError, draw
from .record import Aim, Figure, Result, Row

Array = NDArray[np.float64]
# Frame, right-hand side, initial point, final time, and the solution
_Problem = tuple[Frame, Callable[..., Any], Array, float, Callable[[Array], Array]]

_FRACTIONS = np.linspace(0.0, 1.0, 9)
_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
_MAX_STEPS = 4000
# Of numbers of size one: errors at the steps below this are rounding.
_ROUNDING = 1e-14
_PAIRS = tuple(
    n
    for n, m in methods.items()
    if m.exact_embedded is not None and isinstance(m, cg.Tableau | cg.CommutatorFree)
)


def _top() -> _Problem:
    top = HeavyTop()
    reference = cg.solve_ivp(
        top.f, (0.0, 1.0), top.y0, frame=top.frame, method="CG7b", h=1 / 64, dense_output=True
    ).sol
    assert reference is not None
    return top.frame, top.f, top.y0, 1.0, reference


def _oscillator() -> _Problem:
    def f(t: float, y: Array) -> Array:
        return np.array([y[1], -y[0]])

    def exact(t: Array) -> Array:
        return np.stack([np.cos(t), -np.sin(t)], axis=-1)

    return Euclidean(2), f, np.array([1.0, 0.0]), 10.0, exact


def _frames_of_two() -> _Problem:
    """Two orthonormal vectors in space: a manifold without a logarithm."""
    frame = Stiefel(3, 2)
    y0 = np.eye(3)[:, :2]

    def f(t: float, y: Array) -> Array:
        return np.array([np.sin(t) + y[0, 1], y[1, 0] * np.cos(2.0 * t), 1.0 + 0.5 * y[2, 1]])

    reference = cg.solve_ivp(
        f, (0.0, 2.0), y0, frame=frame, method="CG7b", h=1 / 32, dense_output=True
    ).sol
    assert reference is not None
    return frame, f, y0, 2.0, reference


_PROBLEMS = {
    "harmonic oscillator, R²": _oscillator,
    "heavy top, SO(3) × R³": _top,
    "two vectors, Stiefel(3, 2)": _frames_of_two,
}


TITLE = "Output between steps"
METHOD = (
    f"The error of dense output at {len(_FRACTIONS) - 2} times within each step divided by the "
    "larger error at the ends of the step; the largest such ratio over all steps, tolerances from "
    f"{_TOLERANCES[0]:g} to {_TOLERANCES[-1]:g}, and the problems {'; '.join(_PROBLEMS)}. Runs "
    f"with more than {_MAX_STEPS} steps are left out. Errors below {_ROUNDING:g} count as "
    f"{_ROUNDING:g}."
)


def run(quick: bool, figures: Path | None) -> Result:
    """Measure errors within every step, and at its ends."""
    errors: list[OutputError] = []
    for problem, make in _PROBLEMS.items():
        frame, f, y0, end, exact = make()
        for name in _PAIRS:
            for tolerance in _TOLERANCES[:: 2 if quick else 1]:
                solution = cg.solve_ivp(
                    f, (0.0, end), y0, frame=frame, method=name, rtol=tolerance, atol=tolerance,
                    max_steps=_MAX_STEPS, dense_output=True,
                )  # fmt: skip
                if solution.success:
                    errors.append(_errors(problem, name, tolerance, solution, frame, exact))
    rows = []
    for name in _PAIRS:
        of_method = [x for x in errors if x.method == name]
        worst = max(of_method, key=lambda x: x.ratio)
        rows.append(
            Row(
                f"`{name}`; largest on {worst.problem}, tolerance {worst.tolerance:g}",
                worst.ratio,
                "",
                aim=Aim(3.0, above=False, of="value"),
            )
        )
    if figures is not None:
        draw(errors, figures)
    return Result(
        TITLE,
        METHOD,
        tuple(rows),
        figures=(
            Figure(
                "output_errors",
                "Largest error within steps against largest error at steps, for all pairs, "
                "tolerances and problems; on the dashed line the former is three times the latter.",
            ),
        ),
    )


def _errors(
    problem: str,
    method: str,
    tolerance: float,
    solution: Solution,
    frame: Frame,
    exact: Callable[[Array], Array],
) -> OutputError:
    assert solution.sol is not None
    at = between = ratio = 0.0
    for t0, t1 in pairwise(solution.sol.ts.tolist()):
        t = t0 + (t1 - t0) * _FRACTIONS
        errors = np.maximum(frame.distance(solution.sol(t), exact(t)), _ROUNDING)
        ends, inside = float(max(errors[0], errors[-1])), float(errors[1:-1].max())
        at, between, ratio = max(at, ends), max(between, inside), max(ratio, inside / ends)
    return OutputError(problem, method, tolerance, at, between, ratio if ratio > 0 else math.nan)
