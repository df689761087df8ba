"""Solvers of the cases: pairs, the default of `cg.solve_ivp`, and a competitor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

import cg

from . import projected
from .cases import Case


@dataclass(frozen=True)
class Run:
    """Result of a solver.

    Attributes
    ----------
    points : ndarray, shape (steps + 1, *point_shape)
    evaluations, flows : int
    """

    points: NDArray[Any]
    evaluations: int
    flows: int


Solve = Callable[[float], Run]
"""From a tolerance to a `Run`."""


def pairs(case: Case) -> dict[str, Solve]:
    """Return all explicit pairs by name, those of Munthe-Kaas last."""
    ordered = sorted(cg.methods.items(), key=lambda m: isinstance(m[1], cg.MuntheKaas))
    return {
        name: adaptive(case, name)
        for name, method in ordered
        if method.explicit and method.embedded_order
        if not isinstance(method, cg.MagnusMethod | cg.Splitting)
    }


def adaptive(case: Case, name: str = "auto") -> Solve:
    """Return the solver with a method, by default that of `cg.solve_ivp`."""

    def solve(tolerance: float) -> Run:
        solution = cg.solve_ivp(
            case.f, (0.0, case.end), case.y0, frame=case.frame, method=name, rtol=tolerance,
            atol=tolerance,
        )  # fmt: skip
        return Run(solution.y, solution.nfev, solution.nexp)

    return solve


def dop853(case: Case) -> Solve:
    """Return SciPy's DOP853 with projection after each step."""

    def solve(tolerance: float) -> Run:
        points, evaluations = projected.integrate(
            case.f, case.end, case.y0, case.frame, tolerance, projected=True
        )
        return Run(points, evaluations, 0)

    return solve
