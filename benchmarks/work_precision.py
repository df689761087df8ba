"""Error against time and against exponentials, and drift off the manifold, of all methods."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cg
from cg.frames import Product
from cg.problems import FreeRigidBody, HeavyTop
from cg.tableau import Tableau

from . import projected
from .record import Figure, Result, Row
from .rkmk import RKMK4
from .work_curves import Curve, Point
from .work_figure import draw

Array = NDArray[np.float64]

_END = 2.0
_TARGET = 1e-8
_WORST = 0.1
_ROUNDING = 1e-11
_LEAST_ORDER = 4


def run(quick: bool, figures: Path | None) -> Result:
    """Run all methods with many step sizes on both problems."""
    rounds = 1 if quick else 3
    rows: list[Row] = []
    drawn: list[Figure] = []
    top, body = HeavyTop(), FreeRigidBody()
    problems: list[tuple[str, str, Any, Callable[[float, Any], list[float]]]] = [
        ("heavy top", "work_precision_top", top, top.f),
        ("free rigid body", "work_precision_body", body, _body(body)),
    ]
    for title, name, problem, f in problems:
        curves = _curves(problem, f, rounds, quick)
        rows += _rows(title, curves)
        if figures is not None:
            draw(curves, title, name, figures)
        caption = (
            f"{title.capitalize()}, t = 0 … {_END:g}: error at the end against processor time "
            "and against exponentials, and the drift off the manifold."
        )
        drawn.append(Figure(name, caption))
    return Result(
        "Work and precision",
        f"All methods of the catalogue with fixed steps, RKMK-4, and SciPy's DOP853 with "
        f"projection after each step, all with the same right-hand side in Python. Numbers are for "
        f"an error of {_TARGET:g} at t = {_END:g}, by interpolation; medians of {rounds} rounds.",
        tuple(rows),
        (
            "- Exponential for exponential RKMK-4 is ahead: it needs four a step, a "
            "Crouch–Grossman method of order four twelve to fifteen. For that it needs "
            "commutators, and so flows of the whole Lie algebra that the fields generate, where "
            "a Crouch–Grossman method needs those of the frame's own fields.\n"
            "- DOP853 needs no exponentials, and chooses its steps. The drift of all methods on "
            "manifolds is that of rounding, whatever the step; without projection DOP853 drifts "
            "by about its error.",
        ),
        tuple(drawn),
    )


def _body(body: FreeRigidBody) -> Callable[[float, Array], list[float]]:
    """Return the right-hand side with scalars, as a user in a hurry would write it."""
    rate1, rate2, rate3 = (body.size / moment for moment in body.inertia)

    def f(t: float, y: Array) -> list[float]:
        u1, u2, u3 = y[9:].tolist()
        w1, w2, w3 = rate1 * u1, rate2 * u2, rate3 * u3
        return [w1, w2, w3, -w1, -w2, -w3]

    return f


def _curves(problem: Any, f: Callable[[float, Any], Any], rounds: int, quick: bool) -> list[Curve]:
    frame: Product = problem.frame
    exact = np.array(problem.reference([_END]).y)[0]

    def timed(run: Callable[[], tuple[Array, int]]) -> Point:
        seconds = []
        for _ in range(rounds):
            begin = time.process_time()
            points, exponentials = run()
            seconds.append(time.process_time() - begin)
        error = float(np.abs(points[-1] - exact).max())
        drift = float(frame.membership_error(points).max())
        # rounding alone may leave nothing, which has no logarithm
        return Point(max(error, 1e-17), median(seconds), exponentials, max(drift, 1e-17))

    def own(method: Tableau, steps: int) -> tuple[Array, int]:
        found = cg.integrate(f, (0.0, _END), problem.y0, frame=frame, method=method, h=_END / steps)
        return found.y, found.nexp

    def munthe_kaas(steps: int) -> tuple[Array, int]:
        method = RKMK4(f, frame)
        return method.integrate((0.0, _END), problem.y0, steps), method.nexp

    curves = []
    for name, method in cg.methods.items():
        # each method gets about the same numbers of evaluations
        most = 2 ** (6 if quick else 11)
        counts = [2**k for k in range(2, 12) if 2**k * method.stages <= 2 * most]
        if not method.explicit:
            counts = counts[: 3 if quick else 5]
        points = []
        for count in counts:
            try:
                points.append(timed(lambda m=method, n=count: own(m, n)))  # type: ignore[misc]
            except (cg.ConvergenceError, OverflowError):
                continue  # a step too long for it
        kept = _useful(points)
        curves.append(Curve(name, method.order, method.explicit, True, kept))
    counts = [2**k for k in range(2, 7 if quick else 11)]
    points = [timed(lambda n=count: munthe_kaas(n)) for count in counts]  # type: ignore[misc]
    curves.append(Curve("RKMK-4", 4, True, False, _useful(points)))
    tolerances = [10.0**-k for k in range(3, 11 if quick else 14)]
    for label, wanted in (("DOP853, projected", True), ("DOP853, not projected", False)):
        points = [
            timed(
                lambda tol=tolerance, wanted=wanted: (  # type: ignore[misc]
                    projected.integrate(f, _END, problem.y0, frame, tol, projected=wanted),
                    0,
                )
            )
            for tolerance in tolerances
        ]
        curves.append(Curve(label, 8, True, False, _useful(points)))
    return curves


def _useful(points: list[Point]) -> tuple[Point, ...]:
    """Drop runs whose steps were too long to mean anything, and those that rounding spoilt."""
    kept: list[Point] = []
    for point in points:
        if point.error > _WORST:
            continue
        if kept and kept[-1].error < _ROUNDING and point.error > 0.7 * kept[-1].error:
            break
        kept.append(point)
    return tuple(kept)


def _rows(title: str, curves: list[Curve]) -> list[Row]:
    """Compare the best of each order with the others at the same error."""
    others = {curve.name: curve for curve in curves if not curve.own}
    rows = []
    explicit = [curve for curve in curves if curve.own and curve.explicit]
    for order in sorted({curve.order for curve in explicit if curve.order >= _LEAST_ORDER}):
        for what, unit, scale, against in (
            (_seconds, "ms", 1e3, "RKMK-4"),
            (_exponentials, "exponentials", 1.0, "RKMK-4"),
            (_seconds, "ms", 1e3, "DOP853, projected"),
        ):
            reached = [(c.at(_TARGET, what), c.name) for c in explicit if c.order == order]
            reached = [pair for pair in reached if not np.isnan(pair[0])]
            if not reached:
                continue
            work, name = min(reached)
            other = others[against].at(_TARGET, what)
            if not np.isnan(other):
                ratio = other / work
                rows.append(
                    Row(f"{title}, {name}", scale * work, unit, against, scale * other, ratio)
                )
    return rows


def _seconds(point: Point) -> float:
    return point.seconds


def _exponentials(point: Point) -> float:
    return float(point.exponentials)
