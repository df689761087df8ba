"""What a work-precision diagram shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .solvers import Kind

__all__ = ["QUANTITIES", "Curve", "Point"]

# Runs whose steps are too long to mean anything, and those that rounding has spoilt
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
    drift : float
        Largest distance from the manifold of a point.
    """

    error: float
    seconds: float
    evaluations: int
    flows: int
    drift: float


QUANTITIES: dict[str, Callable[[Point], float]] = {
    "evaluations": lambda p: float(p.evaluations),
    "flows": lambda p: float(p.flows),
    "time": lambda p: p.seconds,
}
"""What work is measured by."""


@dataclass(frozen=True)
class Curve:
    """The runs of one solver, coarsest first.

    Attributes
    ----------
    name : str
    kind : Kind
    order : int
    points : tuple of Point
    """

    name: str
    kind: Kind
    order: int
    points: tuple[Point, ...]

    def at(self, error: float, quantity: str) -> float:
        """Return the work for an error by interpolation of logarithms, NaN beyond the ends."""
        what = QUANTITIES[quantity]
        logs = [(np.log(p.error), np.log(what(p))) for p in self.points if what(p) > 0]
        wanted = np.log(error)
        for (e0, w0), (e1, w1) in pairwise(logs):
            if e1 <= wanted <= e0:
                part = 1.0 if e0 == e1 else (wanted - e0) / (e1 - e0)
                return float(np.exp(w0 + part * (w1 - w0)))
        return float("nan")

    def drift(self, error: float) -> float:
        """Return the largest drift of the runs that are about as accurate or less, or NaN."""
        found = [p.drift for p in self.points if p.error >= 0.1 * error]
        return max(found, default=float("nan"))

    @classmethod
    def of(cls, name: str, kind: Kind, order: int, points: list[Point]) -> Curve:
        """Make a curve of the runs that mean something."""
        kept: list[Point] = []
        for point in points:
            if not point.error <= _WORST:
                continue
            if kept and kept[-1].error < _ROUNDING and point.error > 0.7 * kept[-1].error:
                break
            kept.append(point)
        return cls(name, kind, order, tuple(kept))
