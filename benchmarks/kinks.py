"""Pairs as solvers for SciPy, and SciPy's own, on ten problems with kinks."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import cg
import cg.scipy
from cg.frames import Euclidean, Frame, Product, UnitQuaternion
from reproduce.markdown import table

from .record import Result

Array = NDArray[np.float64]
Problem = tuple[Frame, Callable[[float, Array], Array], Array, float]

BODY, FLIGHT = UnitQuaternion(), Product(Euclidean(6), UnitQuaternion(), Euclidean(3))
SPIN = Product(BODY, Euclidean(3))
INERTIA = np.array([1.0, 2.0, 2.5])
UP, E1, E3 = np.array([0.0, 0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
PAIRS, RIVALS = ("RKMK8(5,3)", "CF5(4)", "CF4(3)", "BS3(2)"), ("RK45", "LSODA")
ERRORS = (1e-2, 1e-3, 1e-4)
TITLE = "Kinks at loose tolerances"
METHOD = (
    "Ten problems with kinks or jumps, which are given to no solver: thrust curves, gain "
    "schedules, tables, contact. Evaluations of `f`, by `scipy.integrate.solve_ivp` with "
    "`cg.scipy.Solver(frame, pair)` and its own solvers, for tolerances from 3e-3 to 1e-7."
)


def turned(q: Array, w: Array) -> Array:
    """Return the derivative of a quaternion with an angular velocity in body axes."""
    return 0.5 * np.append(q[3] * w + np.cross(q[:3], w), -q[:3] @ w)


def rotated(q: Array, v: Array) -> Array:
    """Return a vector in body axes in axes of space."""
    return v + 2.0 * np.cross(q[:3], np.cross(q[:3], v) + q[3] * v)


def body(torque: Callable[[float, Array, Array], Any], w: Any, end: float) -> Problem:
    """Return a rigid body under a torque."""

    def f(t: float, y: Array) -> Array:
        q, w = y[:4], y[4:]
        push = np.asarray(torque(t, q, w)) + np.cross(INERTIA * w, w)
        return np.concatenate([turned(q, w), push / INERTIA])

    return SPIN, f, np.append(UP, w), end


def flight(force: Callable[..., Any], x: Any, v: Any, w: Any, end: float) -> Problem:
    """Return a body that flies, under an acceleration and a torque."""

    def f(t: float, y: Array) -> Array:
        x, v, q, w = y[:3], y[3:6], y[6:10], y[10:]
        push, torque = force(t, x, v, q, w)
        torque = torque + np.cross(INERTIA * w, w)
        return np.concatenate([v, push - 9.81 * E3, turned(q, w), torque / INERTIA])

    return FLIGHT, f, np.concatenate([x, v, UP, w]), end


def problems() -> dict[str, Problem]:
    """Return the problems by name."""
    thrust = np.array([0, 0.1, 0.3, 1.2, 1.9, 2.0]), np.array([0, 60, 45, 40, 25, 0])
    times, random = np.linspace(0, 5, 51), np.random.default_rng(1)
    gyro, gusts = random.normal(size=(51, 3)), random.normal(size=(10, 3))

    def rocket(t: float, x: Array, v: Array, q: Array, w: Array) -> Any:
        drag = 2e-3 * np.interp(x[2], [0, 20, 60, 150], [1.2, 1.1, 0.9, 0.6]) * np.linalg.norm(v)
        return rotated(q, np.interp(t, *thrust) * E3) - drag * v, -0.05 * w

    def bounce(t: float, x: Array, v: Array, q: Array, w: Array) -> Any:
        press = max(-400.0 * x[2] - 4.0 * v[2] * (x[2] < 0), 0.0)
        return press * E3, -0.02 * press * w

    def fall(t: float, x: Array, v: Array, q: Array, w: Array) -> Any:
        angle = math.atan2(math.hypot(*v[:2]), abs(v[2]) + 1e-12)
        return -np.interp(angle, [0, 0.2, 0.6, 1.6], [0.1, 0.12, 0.5, 0.8]) * v, -0.1 * q[:3]

    def scheduled(t: float, q: Array, w: Array) -> Any:
        return -np.interp(np.linalg.norm(w), [0, 0.3, 1, 2], [4, 3, 1, 0.5]) * q[:3] - 0.8 * w

    def motor(t: float, q: Array, w: Array) -> Any:
        return np.interp(w[2], [0, 1, 2, 3, 4], [2, 2, 1.5, 0.7, 0]) * E3 + 0.1 * q[0] * E1

    wheel = 0.4 * E1 + 0.2
    return {
        "thrust curve and drag table": flight(rocket, [0, 0, 0], [0, 0, 1], [0.1, 0.3, 1], 6.0),
        "bouncing": flight(bounce, [0, 0, 1], [1, 0, 0], [0.5, 1, 0.2], 3.0),
        "table of angles": flight(fall, [0, 0, 50], [10, 0, 5], [0.3, 0.1, 0.5], 4.0),
        "gain schedule": body(scheduled, [1.0, 1.5, -0.7], 10.0),
        "saturation": body(lambda t, q, w: np.clip(-6 * q[:3] - 4 * w, -0.5, 0.5), 3 * wheel, 10.0),
        "dead band": body(lambda t, q, w: np.clip(q[:3], -0.2, 0.2) * 3 - 4 * q[:3], wheel, 10.0),
        "friction": body(lambda t, q, w: -0.3 * np.clip(w / 0.02, -1, 1), [1.0, 0.4, -2.0], 4.0),
        "motor's table": body(motor, [0.2, 0.1, 0.0], 5.0),
        "gusts": body(lambda t, q, w: gusts[min(int(2 * t), 9)] - 0.1 * w, wheel, 5.0),
        "gyro samples": (
            BODY,
            lambda t, q: turned(q, np.array([np.interp(t, times, g) for g in gyro.T])), UP, 5.0,
        ),
    }  # fmt: skip


def work(problem: Problem, methods: dict[str, Any], tolerances: Array) -> dict[str, Any]:
    """Return errors at the end and evaluations by method, shape (tolerances, 2)."""
    _, f, y0, end = problem
    exact = solve_ivp(f, (0, end), y0, "DOP853", rtol=1e-10, atol=1e-10, max_step=end / 500)
    curves = {}
    for name, method in methods.items():
        runs = [solve_ivp(f, (0, end), y0, method, rtol=e, atol=e) for e in tolerances]
        errors = [np.abs(run.y[:, -1] - exact.y[:, -1]).max() for run in runs]
        curves[name] = np.array([errors, [run.nfev for run in runs]]).T
    return curves


def evaluations(curve: Array, error: float) -> float:
    """Return the fewest evaluations for an error that no run with more of them exceeds."""
    order = curve[np.argsort(curve[:, 1])]
    good = np.maximum.accumulate(order[::-1, 0])[::-1] <= error
    return float(order[good, 1][0]) if good.any() else math.nan


def run(quick: bool) -> Result:
    """Run all solvers on all problems."""
    tolerances = 10.0 ** -np.arange(2.5, 4.6 if quick else 7.1, 0.5)
    curves = {}
    for name, problem in list(problems().items())[: 2 if quick else None]:
        solvers = {pair: cg.scipy.Solver(problem[0], pair) for pair in PAIRS}
        curves[name] = work(problem, solvers | {rival: rival for rival in RIVALS}, tolerances)
    return result_of(curves)


def result_of(curves: dict[str, dict[str, Array]]) -> Result:
    """Return the geometric means over errors of the evaluations divided by those of rivals."""
    columns = list(product(PAIRS, RIVALS))
    rows = []
    for each in curves.values():
        quotients = [
            [evaluations(each[pair], e) / evaluations(each[rival], e) for e in ERRORS]
            for pair, rival in columns
        ]
        rows.append(np.exp(np.nanmean(np.log(quotients), axis=1)).tolist())
    rows.append(np.exp(np.mean(np.log(rows), axis=0)).tolist())
    names = [*curves, "all, geometric mean"]
    ratios = dict(zip(names, rows, strict=True))
    cells = [[name, *(f"{ratio:.2f}" for ratio in row)] for name, row in ratios.items()]
    head = ["", *(f"{pair}, {rival}" for pair, rival in columns)]
    note = (
        "Evaluations of pairs divided by those of SciPy's solvers at errors of 1e-2, 1e-3 and "
        f"1e-4:\n\n{table(head, cells)}"
    )
    return Result(TITLE, METHOD, (), (note,), {"ratios": ratios})
