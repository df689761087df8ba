"""Numbers that decide claims and are not part of a figure or table."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.integrate import solve_ivp

from cg.construction.catalogue import methods
from cg.construction.conditions import count, jacobian, residuals
from cg.construction.layouts import Layout
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.method import Method
from cg.construction.methods.tolerance import to_floats
from cg.construction.trees import catalan, forest
from cg.frames import Euclidean
from cg.integration import integrate
from cg.problems import HeavyTop, StateDependentRotation
from cg.problems.convergence import final_errors, observed_order
from cg.support.arrays import Array

from .blocks import Data, median
from .coefficients import RANK_THRESHOLD, condition_number, largest_coefficient
from .sections.table3_2 import PAPER

_POINTS = 5
_HIGH_ORDER = 10
_PRINTED = 8  # decimals of CG6a in the paper
_TESTED = {
    "explicit": ("CG3", "CG4", "CG4a", "CG5a"),
    "implicit": ("ImplicitMidpoint", "DICG3", "DICG4", "DICG4b", "DICG6"),
    "Munthe-Kaas": tuple(
        name for name, method in methods.items() if isinstance(method, MuntheKaas)
    ),
}
_DRIFT_TIMES = (1.0, 10.0, 100.0)
_DISTINGUISHED = ("CG4", "CG4a", "CG5a", "CG6a")


def gather(seed: int) -> Data:
    """Compute all numbers that judges need, by name.

    ``conditions``, by order at random tableaux: the smallest and largest ``rank`` of the Jacobian
    of all conditions, and the median ``condition_number`` of that of the independent ones.
    ``methods``: ``exact_order``, ``largest_coefficient``, range of ``abscissae``,
    ``condition_number`` of the Jacobian (null without full rank). ``approximate``, decimals to
    which CG6a satisfies conditions through order six: ``worst``, ``root_mean_square``, ``median``,
    how many of ``conditions`` hold to ``six``, and what the digits that the paper doesn't print can
    change (``truncation``). ``rotation_slopes``, by kind of method and name, on a rotation whose
    velocity depends on it. ``drift`` of SciPy's solvers from orthogonal matrices at
    ``drift_times``. ``flat``: the largest difference from classical methods. ``initial``: how far
    B(0) is from a rotation. ``trees``: how many are ``generated`` for an ``order``, and
    ``expected``.
    """
    return {
        "conditions": {str(row["q"]): _conditions(row["q"], row["s"], seed) for row in PAPER},
        "methods": {name: _method(methods[name]) for name in (*_DISTINGUISHED, "CG3")},
        "approximate": _approximate(methods["CG6a"]),
        "rotation_slopes": _rotation_slopes(),
        "drift": {"RK45": _drift("RK45"), "DOP853": _drift("DOP853")},
        "drift_times": _DRIFT_TIMES,
        "flat": {name: _flat(methods[name]) for name in _DISTINGUISHED},
        "initial": _initial(),
        "trees": {
            "order": _HIGH_ORDER,
            "generated": len(forest(_HIGH_ORDER + 1)),
            "expected": sum(map(catalan, range(_HIGH_ORDER + 1))),
        },
    }


def _conditions(order: int, stages: int, seed: int) -> Data:
    ranks, numbers = [], []
    for index in range(_POINTS):
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(order, index)))
        layout = Layout.tableau(stages)
        x = generator.uniform(-1, 1, layout.size)
        every, independent = (
            np.linalg.svd(jacobian(layout, x, order, independent=flag), compute_uv=False)
            for flag in (False, True)
        )
        ranks.append(int((every > RANK_THRESHOLD * every[0]).sum()))
        numbers.append(float(independent[0] / independent[-1]))
    return {
        "points": _POINTS,
        "rank": [min(ranks), max(ranks)],
        "independent": count(order, independent=True),
        "all": count(order),
        "condition_number": median(numbers),
    }


def _method(method: Method) -> Data:
    return {
        "exact_order": method.exact_order,
        "largest_coefficient": largest_coefficient(method),
        "abscissae": [float(method.c.min()), float(method.c.max())],
        "condition_number": condition_number(method, method.order),
    }


def _approximate(method: Method) -> Data:
    sizes = [abs(float(r)) for r in residuals(method, method.order, arithmetic="exact")]
    square = math.sqrt(sum(size * size for size in sizes) / len(sizes))
    derivatives = jacobian(
        method.layout, to_floats(method.coefficients), method.order, independent=False
    )
    return {
        "truncation": 10.0**-_PRINTED * float(np.abs(derivatives).sum(axis=1).max()),
        "worst": -math.log10(max(sizes)),
        "root_mean_square": -math.log10(square),
        "median": -math.log10(median(sizes)),
        "conditions": len(sizes),
        "six": sum(size <= 1e-6 for size in sizes),
    }


def _rotation_slopes() -> Data:
    problem = StateDependentRotation()
    exact = problem.reference([1]).y[0, :9].reshape(3, 3)

    def slope(method: Method) -> Data:
        h = [1 / steps for steps in ((4, 8, 16) if method.order > 5 else (16, 32, 64, 128))]
        errors = final_errors(
            problem.f, (0.0, 1.0), problem.y0, exact, frame=problem.frame, method=method, h=h
        )
        slope = observed_order(h, errors, floor=1e-13)
        return {"order": method.exact_order, "slope": slope}

    return {kind: {name: slope(methods[name]) for name in names} for kind, names in _TESTED.items()}


def _drift(solver: Literal["RK45", "DOP853"]) -> list[float]:
    top = HeavyTop()

    def slope(t: float, y: Array) -> Array:
        return np.asarray(top.frame.field(top.f(t, y), y), dtype=np.float64)

    solution = solve_ivp(slope, (0.0, _DRIFT_TIMES[-1]), top.y0, method=solver, t_eval=_DRIFT_TIMES)
    rotations = solution.y[:9].T.reshape(-1, 3, 3)
    away = rotations.swapaxes(1, 2) @ rotations - np.eye(3)
    return [float(size) for size in np.linalg.norm(away, 2, axis=(1, 2))]


def _flat(method: Method) -> float:
    """Return the largest difference from the classical method on three coupled equations."""

    def f(t: float, y: Sequence[float] | Array) -> Array:
        return np.array([y[1] * y[2] + t, np.sin(y[0]) - y[2], y[0] * y[1] - t * y[2]])

    y, h = np.array([0.3, -0.4, 0.5]), 0.125
    solution = integrate(f, (0.0, 1.0), y, frame=Euclidean(3), method=method, h=h)
    worst = 0.0
    for t, following in zip(solution.t, solution.y[1:], strict=False):
        slopes: list[Array] = []
        for row, c in zip(method.a, method.c, strict=True):
            stage = y + h * sum((w * k for w, k in zip(row, slopes, strict=False)), np.zeros(3))
            slopes.append(f(float(t + c * h), stage))
        y = np.asarray(y + h * (method.b @ np.array(slopes)))
        worst = max(worst, float(np.abs(y - following).max()))
    return worst


def _initial() -> Data:
    rotation = HeavyTop().y0[:9].reshape(3, 3)
    return {
        "orthogonality": float(np.abs(rotation.T @ rotation - np.eye(3)).max()),
        "determinant": abs(float(np.linalg.det(rotation)) - 1),
    }
