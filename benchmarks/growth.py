"""Growth of time and memory of a search with the order and the number of points."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from .record import Aim, Result, Row

TITLE = "Growth of a search with order and points"
METHOD = (
    "One step of the solver for commutator-free methods with a chain of points and a third as many "
    "stages, each in its own process. The predicted time is a sum of four terms whose constants "
    "are fitted to all measured times: a constant; trees × unknowns, for the weights; conditions × "
    "trees × unknowns, for the derivatives; and m² n + m³/3, for the normal equations of m "
    "conditions in n unknowns."
)
DETAILS = (
    "Times of one step. The memory is the growth of the process; the number in parentheses is the "
    "size of two Jacobians and of the matrix of the normal equations."
)
ORDERS = (3, 4, 5, 6, 7, 8, 9)
POINTS = (6, 12, 24, 40, 60)

_MEASURE = """
import json, resource, sys, time
import numpy as np
from cg.conditions import count
from cg.structure.layout import Layout
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.system import ConditionSystem
from threadpoolctl import threadpool_limits

order, points, budget = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
stages = max(2, points // 3)
places = [-1, *(k * points // stages - 1 for k in range(1, stages))]
weights = tuple(tuple(j for j in range(stages) if places[j] < k) for k in range(points))
layout = Layout(tuple(range(-1, points - 1)), weights, tuple(places), (points - 1,))
system = ConditionSystem(order, layout)
x = np.random.default_rng(1).uniform(-0.4, 0.4, system.size)
with threadpool_limits(1):
    small = ConditionSystem(2, layout)
    fit_conditions(x, small, max_iterations=2)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    steps, best = 1, float("inf")
    ends = time.perf_counter() + budget
    while True:
        began = time.process_time()
        fit = fit_conditions(x, system, max_iterations=steps, ftol=0.0)
        spent = time.process_time() - began
        best = min(best, spent / max(1, fit.iterations))
        if time.perf_counter() > ends:
            break
        steps = min(20, 2 * steps)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps({
    "seconds": best, "megabytes": (after - before) / 1024,
    "conditions": count(order, independent=True), "trees": count(order), "unknowns": system.size,
}))
"""


def run(quick: bool, figures: Path | None) -> Result:
    """Measure one step of the solver for each order and number of points."""
    orders, points = (ORDERS[:3], POINTS[:2]) if quick else (ORDERS, POINTS)
    budget = 0.2 if quick else 1.5
    cells = [
        (order, number, _measured(order, number, budget)) for order in orders for number in points
    ]
    predicted = _predicted([measured for _, _, measured in cells])
    rows = []
    for (order, number, measured), seconds in zip(cells, predicted, strict=True):
        theory = 8e-6 * measured["conditions"] * (2 * measured["unknowns"] + measured["conditions"])
        rows.append(
            Row(
                f"order {order}, {number} points: {measured['conditions']} conditions, "
                f"{measured['unknowns']} unknowns, {measured['megabytes']:.0f} MB "
                f"({theory:.0f})",
                1e3 * measured["seconds"],
                "ms per step",
                "predicted",
                1e3 * seconds,
                measured["seconds"] / seconds,
            )
        )
    ratios = [row.ratio for row in rows if row.ratio is not None]
    inside = sum(0.5 <= ratio <= 2.0 for ratio in ratios) / len(ratios)
    summary = Row(
        "steps predicted to a factor of two", 100 * inside, "%", aim=Aim(90, True, "value")
    )
    return Result(TITLE, METHOD, (summary,), details=Result(TITLE, DETAILS, tuple(rows)))


def _measured(order: int, points: int, budget: float) -> dict[str, float]:
    command = [sys.executable, "-c", _MEASURE, str(order), str(points), str(budget)]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    measured: dict[str, float] = json.loads(process.stdout)
    return measured


def _predicted(measured: list[dict[str, float]]) -> list[float]:
    """Return the predicted times, with constants that minimise the relative errors."""
    terms = np.array(
        [
            [
                1.0,
                one["trees"] * one["unknowns"],
                one["conditions"] * one["trees"] * one["unknowns"],
                one["conditions"] ** 2 * one["unknowns"] + one["conditions"] ** 3 / 3,
            ]
            for one in measured
        ]
    )
    seconds = np.array([one["seconds"] for one in measured])
    constants, _ = nnls(terms / seconds[:, None], np.ones(len(measured)))
    return [math.fsum(map(float, row)) for row in terms * constants]
