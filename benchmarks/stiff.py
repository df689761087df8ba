"""Stiff equations, compared with SciPy's Radau on vectors and with the default explicit method."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

import cg
from cg.frames import Euclidean, Frame, Product, Sphere, UnitQuaternion

from .record import Aim, Result, Row
from .timing import measure

TITLE = "Stiff equations"
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
ERRORS = (1e-4, 1e-7)


def method_text(rounds: int) -> str:
    """Return how costs are measured."""
    return (
        '`method="RadauIIA5"` and SciPy\'s `Radau`, both with Jacobians by differences and the '
        "same right-hand side in Python: as coefficients of the frame here, as the derivative of a "
        "vector there. Costs at equal errors at the end, interpolated between tolerances from 1e-3 "
        "to 1e-9, or at 1e-3 if the error is smaller there; evaluations include those of "
        "Jacobians, and a factorisation is one of a real or of a complex matrix. Smaller ratios "
        "are better. The body's wheels have friction 10⁴ times faster than the body. Medians of "
        f"{rounds} rounds; the default explicit method is measured once."
    )


class Problem(NamedTuple):
    """A stiff equation: its coefficients in a frame, and as a derivative of a vector."""

    name: str
    frame: Frame
    f: Callable[[float, Any], Any]
    derivative: Callable[[float, Any], Any]
    y0: Any
    t1: float


def van_der_pol() -> Problem:
    """Return the equation of van der Pol with the parameter 1000."""

    def f(t: float, y: Any) -> Any:
        return np.array([y[1], 1e3 * (1.0 - y[0] ** 2) * y[1] - y[0]])

    return Problem("van der Pol", Euclidean(2), f, f, np.array([2.0, 0.0]), 2000.0)


def wheels() -> Problem:
    """Return a body with three reaction wheels, whose friction is 10⁴ times faster than the body.

    A point is the attitude, the angular velocity and the speeds of the wheels.
    """
    frame = Product(UnitQuaternion(), Euclidean(6))
    inertia, wheel, friction = np.array([1.0, 2.0, 3.0]), 0.01, 100.0

    def f(t: float, y: Any) -> Any:
        rate, speed = y[4:7], y[7:]
        torque = 0.2 * np.array([np.sin(t), np.cos(2.0 * t), y[0]]) - friction * speed
        momentum = inertia * rate + wheel * speed
        a, b = momentum, rate
        turn = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        acceleration = (turn - torque) / inertia
        return np.concatenate([rate, acceleration, torque / wheel - acceleration])

    def derivative(t: float, y: Any) -> Any:
        coefficients = f(t, y)
        (x, y_, z, w), (a, b, c) = y[:4], y[4:7]
        moved = [w * a + y_ * c - z * b, w * b + z * a - x * c, w * c + x * b - y_ * a]
        scalar = -(x * a + y_ * b + z * c)
        return np.concatenate([0.5 * np.array([*moved, scalar]), coefficients[3:]])

    y0 = np.array([0.0, 0.0, 0.0, 1.0, 0.5, 1.0, 0.7, 0.0, 0.0, 0.0])
    return Problem("body with reaction wheels", frame, f, derivative, y0, 10.0)


def spins(sites: int = 30) -> Problem:
    """Return a damped chain of spins, after Landau and Lifshitz, with strong exchange."""
    frame = Product(*[Sphere(2)] * sites)
    exchange, damping = 500.0, 0.5

    def f(t: float, y: Any) -> Any:
        s = y.reshape(sites, 3)
        field = np.zeros_like(s)
        field[1:] += exchange * (s[:-1] - s[1:])
        field[:-1] += exchange * (s[1:] - s[:-1])
        field += [np.sin(t), np.cos(t), 1.0]
        return (field + damping * cross(s, field)).ravel()

    def derivative(t: float, y: Any) -> Any:
        return cross(f(t, y).reshape(sites, 3), y.reshape(sites, 3)).ravel()

    def cross(a: Any, b: Any) -> Any:
        (x, y, z), (u, v, w) = a.T, b.T
        return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)

    angle = np.linspace(0.0, 1.0, sites)
    y0 = np.stack([np.sin(angle), np.zeros(sites), np.cos(angle)], axis=1).ravel()
    return Problem(f"chain of {sites} spins", frame, f, derivative, y0, 5.0)


def coupled(size: int = 300) -> Problem:
    """Return a system with a large matrix without zeros: here factors take more time than f."""
    k = np.arange(size)
    matrix = 0.1 * np.cos(np.outer(k, k)) - np.diag(10.0 ** np.linspace(0.0, 4.0, size))

    def f(t: float, y: Any) -> Any:
        return matrix @ y - y**3

    return Problem(f"{size} unknowns, all coupled", Euclidean(size), f, f, np.ones(size), 1.0)


def run(quick: bool, figures: Path | None) -> Result:
    """Measure evaluations, factorisations and processor time."""
    rounds = 3 if quick else 7
    rows: list[Row] = []
    for problem in (van_der_pol(), wheels(), spins(), coupled()):
        rows += _rows(problem, rounds)
    return Result(TITLE, method_text(rounds), tuple(rows))


def _here(problem: Problem, tolerance: float, method: str = "RadauIIA5") -> cg.Solution:
    return cg.solve_ivp(
        problem.f, (0.0, problem.t1), problem.y0, frame=problem.frame, method=method,
        rtol=tolerance, atol=tolerance, t_eval=[problem.t1],
    )  # fmt: skip


def _there(problem: Problem, tolerance: float) -> Any:
    return solve_ivp(
        problem.derivative, (0.0, problem.t1), problem.y0, method="Radau",
        rtol=tolerance, atol=tolerance, t_eval=[problem.t1],
    )  # fmt: skip


def _rows(problem: Problem, rounds: int) -> list[Row]:
    exact = _here(problem, 1e-12).y[-1]
    explicit = measure({"": partial(_here, problem, 1e-5, "auto")}, rounds=1, warm_up=False)
    ways: dict[str, Callable[[], object]] = {}
    for tolerance in TOLERANCES:
        ways[f"here {tolerance}"] = partial(_here, problem, tolerance)
        ways[f"there {tolerance}"] = partial(_there, problem, tolerance)
    times = measure(ways, rounds=rounds, seconds=0.01)
    costs: dict[str, list[tuple[float, ...]]] = {"here": [], "there": []}
    for tolerance in TOLERANCES:
        run, other = _here(problem, tolerance), _there(problem, tolerance)
        # SciPy doesn't count the evaluations of a Jacobian
        evaluations = other.nfev + other.njev * (len(problem.y0) + 1)
        counts = {
            "here": (run.y[-1], run.nfev, run.nlu),
            "there": (other.y[:, -1], evaluations, other.nlu),
        }
        for name, (y, *numbers) in counts.items():
            seconds = times.median(f"{name} {tolerance}")
            costs[name].append((float(np.abs(y - exact).max()), *numbers, 1e3 * seconds))
    rows = []
    units = {"evaluations": 1.3, "factorisations": 1.3, "ms": 1.0}
    for error in ERRORS:
        for column, (unit, bound) in enumerate(units.items(), 1):
            here, there = (_at_error(costs[name], column, error) for name in ("here", "there"))
            name, aim = f"{problem.name}, error {error:.0e}", Aim(bound, above=False)
            rows.append(Row(name, here, unit, "SciPy's Radau", there, here / there, aim=aim))
    here, there = 1e3 * times.median("here 1e-05"), 1e3 * explicit.median("")
    name = f"{problem.name}, tolerance 1e-5"
    rows.append(
        Row(name, here, "ms", "the default", there, here / there, aim=Aim(1.0, above=False))
    )
    return rows


def _at_error(costs: list[Any], column: int, error: float) -> float:
    """Return a cost at an error, by interpolation of logarithms."""
    table = np.log(np.array(sorted(costs), dtype=float))
    return float(np.exp(np.interp(np.log(error), table[:, 0], table[:, column])))
