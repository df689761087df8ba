"""What a work-precision diagram shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

__all__ = ["Curve", "Point"]


@dataclass(frozen=True)
class Point:
    """One run.

    Attributes
    ----------
    error : float
        Largest error of an entry of the final point.
    seconds : float
        Processor time, median over rounds.
    exponentials : int
        Flows of the frame; 0 if there are none.
    drift : float
        Largest distance from the manifold of a point.
    """

    error: float
    seconds: float
    exponentials: int
    drift: float


@dataclass(frozen=True)
class Curve:
    """The runs of one method, coarsest first.

    Attributes
    ----------
    name : str
    order : int
    explicit : bool
    own : bool
        Whether the method is of the catalogue.
    points : tuple of Point
    """

    name: str
    order: int
    explicit: bool
    own: bool
    points: tuple[Point, ...]

    def at(self, error: float, what: Callable[[Point], float]) -> float:
        """Return the work for an error by interpolation of logarithms, NaN beyond the ends."""
        logs = [(np.log(p.error), np.log(what(p))) for p in self.points if what(p) > 0]
        wanted = np.log(error)
        for (e0, w0), (e1, w1) in pairwise(logs):
            if e1 <= wanted <= e0:
                return float(np.exp(w0 + (wanted - e0) / (e1 - e0) * (w1 - w0)))
        return float("nan")
