"""Curves of error against work, for work-precision diagrams."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

import numpy as np

from .cases import Case
from .solvers import Run

# Larger errors are those of steps that are too long; rounding dominates smaller ones.
_WORST = 0.1
_ROUNDING = 1e-11


@dataclass(frozen=True)
class Point:
    """One run.

    Attributes
    ----------
    error : float
        Largest error of an entry of the final point.
    seconds : float
        Processor time, median over rounds.
    evaluations : int
        Of the right-hand side.
    flows : int
        Of the frame; 0 if there are none.
    """

    error: float
    seconds: float
    evaluations: int
    flows: int

    @classmethod
    def of(cls, case: Case, run: Run, seconds: float) -> Point:
        """Make the point of a run."""
        # rounding alone may leave nothing, which has no logarithm
        error = max(case.error(run.points[-1]), 1e-17)
        return cls(error, seconds, run.evaluations, run.flows)


QUANTITIES: dict[str, Callable[[Point], float]] = {
    "evaluations": lambda p: float(p.evaluations),
    "flows": lambda p: float(p.flows),
    "time": lambda p: p.seconds,
}
"""Measures of work by name."""


@dataclass(frozen=True)
class Curve:
    """The runs of one solver, coarsest first.

    Attributes
    ----------
    points : tuple of Point
    """

    points: tuple[Point, ...]

    def at(self, error: float, quantity: str) -> float:
        """Return the work for an error by interpolation of logarithms, NaN beyond the ends."""
        what = QUANTITIES[quantity]
        logs = [(np.log(p.error), np.log(what(p))) for p in self.points if what(p) > 0]
        log_error = np.log(error)
        for (e0, w0), (e1, w1) in pairwise(logs):
            if e1 <= log_error <= e0:
                part = 1.0 if e0 == e1 else (log_error - e0) / (e1 - e0)
                return float(np.exp(w0 + part * (w1 - w0)))
        return float("nan")

    @classmethod
    def of(cls, points: list[Point]) -> Curve:
        """Make a curve of the runs that are neither too coarse nor dominated by rounding."""
        usable: list[Point] = []
        for point in points:
            if not point.error <= _WORST:
                continue
            if usable and usable[-1].error < _ROUNDING and point.error > 0.7 * usable[-1].error:
                break
            usable.append(point)
        return cls(tuple(usable))


def run_point(
    case: Case, solve: Mapping[str, Callable[[float], Run]], setting: float, rounds: int
) -> dict[str, Point]:
    """Run several solvers in turns with one setting; times are medians over the rounds."""
    seconds: dict[str, list[float]] = {name: [] for name in solve}
    runs: dict[str, Run] = {}
    for _ in range(rounds):
        for name, one in solve.items():
            begin = time.process_time()
            runs[name] = one(setting)
            seconds[name].append(time.process_time() - begin)
    return {name: Point.of(case, run, median(seconds[name])) for name, run in runs.items()}


def run_curves(
    case: Case, solve: Mapping[str, Callable[[float], Run]], settings: Iterable[float], rounds: int
) -> dict[str, Curve]:
    """Return error against work of several solvers, which run in turns with each setting."""
    points = [run_point(case, solve, setting, rounds) for setting in settings]
    return {name: Curve.of([by[name] for by in points]) for name in solve}
