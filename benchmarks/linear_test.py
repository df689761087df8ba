"""Measure orders of CG4a and LieRK4 on the test problems of OrdinaryDiffEq.jl.

``python -m benchmarks.linear_test`` writes ``linear_test.json``. The problems are
``u' = [[0, -1], [s, 0]] u`` with ``s = sin(u_1)``, on which that package tests its methods for Lie
groups, and with ``s = sin(t)``. The methods are taken as published, and as that package has them.
The third problem is `cg.problems.StateDependentRotation`, which depends on all order conditions.
"""

from __future__ import annotations

import cmath
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import cg
from cg.analysis.convergence import final_errors, observed_order

DATA = Path(__file__).with_name("linear_test.json")
Vector = tuple[float, float]
Entry = Callable[[float, Vector], float]
PROBLEMS: dict[str, tuple[Entry, float, range]] = {
    "sin(u)": (lambda t, u: math.sin(u[0]), 5.0, range(4, 9)),
    "sin(t)": (lambda t, u: math.sin(t), 5.0, range(2, 7)),
}
ROTATION_STEPS = (16, 24, 32, 48, 64)


def flow(upper: float, lower: float, u: Vector) -> Vector:
    """Return exp([[0, upper], [lower, 0]]) u."""
    root = cmath.sqrt(upper * lower)
    diagonal = cmath.cosh(root).real
    factor = (cmath.sinh(root) / root).real if root else 1.0
    return diagonal * u[0] + factor * upper * u[1], diagonal * u[1] + factor * lower * u[0]


def end_of(method: cg.Method, times: list[float], entry: Entry, end: float, steps: int) -> Vector:
    """Return the solution after steps of a method whose stages are evaluated at given times."""
    u, h = (1.0, 1.0), end / steps
    weights = [{k: float(w) for k, w in point.weights.items()} for point in method.points]
    for step in range(steps):
        entries: list[float] = []
        reached: list[Vector] = []
        for m, point in enumerate(method.points):
            while len(entries) < method.stages and method.stage_points[len(entries)] < m:
                k = len(entries)
                at = reached[method.stage_points[k]] if method.stage_points[k] >= 0 else u
                entries.append(entry((step + times[k]) * h, at))
            start = reached[point.parent] if point.parent >= 0 else u
            total = sum(weights[m].values())
            lower = sum(w * entries[k] for k, w in weights[m].items())
            reached.append(flow(-h * total, h * lower, start))
        u = reached[method.result]
    return u


def slope_on(problem: str, method: cg.Method, times: list[float]) -> float:
    """Return the observed order on a linear problem."""
    entry, end, powers = PROBLEMS[problem]
    exact = solve_ivp(
        lambda t, u: np.array([-u[1], entry(t, (u[0], u[1])) * u[0]]), (0, end), [1.0, 1.0],
        method="DOP853", rtol=1e-13, atol=1e-13,
    ).y[:, -1]  # fmt: skip
    counts = [round(end) * 2**power for power in powers]
    errors = [math.dist(end_of(method, times, entry, end, n), exact) for n in counts]
    return observed_order([end / n for n in counts], errors, floor=2e-11).order


def slope_on_rotation(method: cg.Method) -> float:
    """Return the observed order on a rotation that depends on itself."""
    problem = cg.problems.StateDependentRotation()
    exact = np.array([float(x) for x in problem.reference([0, 1]).values[-1][:9]]).reshape(3, 3)
    h = [1 / n for n in ROTATION_STEPS]
    errors = final_errors(
        problem.f, (0, 1), problem.y0, exact, frame=problem.frame, method=method, h=h
    )
    return observed_order(h, errors, floor=2e-13).order


def main() -> None:
    """Measure and store all slopes."""
    published, four = cg.methods["CG4a"], cg.methods["CF4"]
    rows = [[f"{x:.17g}" for x in row[:r][::-1]] for r, row in enumerate(published.a)]
    reversed_rows = cg.Tableau(rows, [f"{x:.17g}" for x in published.b])
    slopes = {}
    for name, method, times in (
        ("`CG4a` as published", published, list(published.c)),
        ("`CG4a` with reversed rows", reversed_rows, list(published.c)),
        ("`LieRK4` as published (`CF4`)", four, list(four.c)),
        ("`LieRK4` with all stages at the start of the step", four, [0.0] * four.stages),
    ):
        slopes[name] = {problem: slope_on(problem, method, times) for problem in PROBLEMS}
        if list(method.c) == times or method is reversed_rows:
            slopes[name]["rotation"] = slope_on_rotation(method)
        print(name, slopes[name])
    DATA.write_text(json.dumps(slopes, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
