"""The solvers of a contest, each with its settings from coarse to fine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import cg

from . import projected
from .cases import Case
from .lielab_rival import METHODS, LielabRival, expresses
from .magnus import Magnus

Kind = Literal["pair", "fixed", "rkmk", "rival", "default"]
"""Pairs of the catalogue, methods with fixed steps, Munthe-Kaas methods, solvers of other packages,
and the default of `cg.solve_ivp`."""

_MIN_ORDER = 4


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


@dataclass(frozen=True)
class Solver:
    """A solver with a list of settings.

    Attributes
    ----------
    name : str
    kind : Kind
    order : int
    settings : tuple of float
        Tolerances or numbers of steps, coarse first.
    solve : callable
        From a setting to a `Run`.
    """

    name: str
    kind: Kind
    order: int
    settings: tuple[float, ...]
    solve: Callable[[float], Run]


def pairs(case: Case, tolerances: tuple[float, ...]) -> Iterator[Solver]:
    """Yield all explicit pairs, those of Munthe-Kaas last."""
    for name, method, kind in _explicit():
        if method.embedded_order is not None and method.embedded_order > 0:
            yield Solver(name, kind, method.order, tolerances, _adaptive(case, name))


def _explicit() -> Iterator[tuple[str, cg.Method, Kind]]:
    for name, method in sorted(cg.methods.items(), key=lambda m: isinstance(m[1], cg.MuntheKaas)):
        if method.explicit and not isinstance(method, cg.MagnusMethod | cg.Splitting):
            yield name, method, "rkmk" if isinstance(method, cg.MuntheKaas) else "pair"


def solvers(case: Case, quick: bool) -> Iterator[Solver]:
    """Yield all solvers that can solve a case."""
    tolerances = tuple(10.0**-k for k in range(3, 9 if quick else 14))
    yield from pairs(case, tolerances)
    for name, method, kind in _explicit():
        if method.order >= _MIN_ORDER:
            steps = _steps(case.budget // (8 if quick else 1), method.stages)
            label = f"{name}, fixed" if method.embedded_order else name
            fixed: Kind = "rkmk" if kind == "rkmk" else "fixed"
            yield Solver(label, fixed, method.order, steps, _fixed(case, name))
    yield Solver("default of solve_ivp", "default", 0, tolerances, _adaptive(case, None))
    if expresses(case):
        for name, order in METHODS.items():
            yield Solver(f"Lielab {name}", "rival", order, tolerances, _lielab(case, name))
    for label, project in (("DOP853, projected", True), ("DOP853, not projected", False)):
        yield Solver(label, "rival", 8, tolerances, _dop853(case, project))
    if case.linear:
        for order, stages in ((4, 2), (6, 3)):
            steps = _steps(case.budget, stages)
            yield Solver(f"Magnus {order}", "rival", order, steps, _magnus(case, order))


def _steps(budget: int, stages: int) -> tuple[float, ...]:
    return tuple(float(2**k) for k in range(1, 13) if 2**k * stages <= budget)


def _adaptive(case: Case, name: str | None) -> Callable[[float], Run]:
    options: dict[str, Any] = {} if name is None else {"method": name}

    def solve(tolerance: float) -> Run:
        solution = cg.solve_ivp(
            case.f, (0.0, case.end), case.y0, frame=case.frame, rtol=tolerance, atol=tolerance,
            **options,
        )  # fmt: skip
        return Run(solution.y, solution.nfev, solution.nexp)

    return solve


def _fixed(case: Case, name: str) -> Callable[[float], Run]:
    def solve(steps: float) -> Run:
        h = case.end / steps
        solution = cg.integrate(
            case.f, (0.0, case.end), case.y0, frame=case.frame, method=name, h=h
        )
        return Run(solution.y, solution.nfev, solution.nexp)

    return solve


def _dop853(case: Case, project: bool) -> Callable[[float], Run]:
    def solve(tolerance: float) -> Run:
        points, evaluations = projected.integrate(
            case.f, case.end, case.y0, case.frame, tolerance, projected=project
        )
        return Run(points, evaluations, 0)

    return solve


def _lielab(case: Case, name: str) -> Callable[[float], Run]:
    rival = LielabRival(case, name)

    def solve(tolerance: float) -> Run:
        points = rival.integrate(tolerance)
        return Run(points, rival.evaluations, 0)

    return solve


def _magnus(case: Case, order: int) -> Callable[[float], Run]:
    group = case.frame
    assert isinstance(group, cg.frames.MatrixGroup)

    def solve(steps: float) -> Run:
        method = Magnus(case.f, group, order)
        points = method.integrate(case.end, case.y0, round(steps))
        return Run(np.asarray(points), method.nfev, method.nexp)

    return solve
