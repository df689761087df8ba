"""The weights of methods with two registers, which the last two weights of each point determine.

Point m of the chain is reached along ``h B_m Z_m`` with ``Z_m = A_m Z_(m-1) + F_m``, so that its
weights w are those before it times one number, but the last one:

    w_m,k = w_m,m-1 w_(m-1),k / w_(m-1),m-1 for k < m - 1,

with stages counted as points are. Solvers move w_m,m = B_m and w_m,m-1 = A_m B_m, and the other
weights follow. To the second result of a pair of order three lead two flows from the start of the
step, which a step that may be rejected stores anyway: along the register at the end, and along the
field at the result, with which the next step begins. From order four on there is no such pair; one
flow along the register leads there from the point after the second stage. From the result itself
such flows would see nothing of errors by commutators in ``F(t) = X + t V``: the register and the
field are parallel there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.layouts.layout import Layout
from cg.construction.layouts.points import START
from cg.support import quads


def register_chain(stages: int, order: int, pair: bool) -> Layout:
    """Return the points of a two-register method; up to order three a pair has a stage at its end.

    >>> register_chain(3, 2, True).stage_points
    (-1, 0, 1)
    """
    at_end = pair and order < 4
    last = stages - 1 - at_end  # the result
    weights = [tuple(range(m + 1)) for m in range(last + 1)]
    parents = list(range(START, last))
    if pair:
        weights += [weights[last], (last + 1,)][: 1 + at_end]
        parents += [START, last + 1] if at_end else [1]
    stage_points, results = range(START, stages - 1), (last, len(weights) - 1)[: 1 + pair]
    return Layout(tuple(parents), tuple(weights), tuple(stage_points), results)


@dataclass(frozen=True, eq=False)
class RegisterWeights:
    """What the free weights of a chain determine, in the place of `Held`."""

    layout: Layout
    dependent = True

    @cached_property
    def pivots(self) -> NDArray[np.intp]:
        """The weights that follow from others."""
        return np.array([k for follow, _, _ in self._rows() for k in follow], dtype=np.intp)

    def complete(self, x: Any) -> NDArray[Any]:
        """Return weights, doubles or Fractions, with those that follow; not finite for B = 0."""
        x = np.array(x)
        if x.dtype == object and any(x[before[-1]] == 0 for _, _, before in self._rows()):
            raise ZeroDivisionError("B must not be 0, or the next stage repeats the one before it")
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for follow, lead, before in self._rows():
                x[follow] = x[lead] / x[before[-1]] * x[before[:-1]]
        return np.asarray(x)

    def derivatives(self, jac: NDArray[np.float64], x: Any) -> NDArray[np.float64]:
        """Return derivatives at x, shape (m, size), by the free weights; 0 for others."""
        along, x = np.eye(self.layout.size), self.complete(x)
        along[self.pivots] = 0.0
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for follow, lead, (*others, last) in self._rows():
                ratio = x[lead] / x[last]
                change = (along[lead] - ratio * along[last]) / x[last]
                along[follow] = np.outer(x[others], change) + ratio * along[others]
            return np.asarray(jac @ along)

    def guess(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return likely weights from random ones: B positive, A from -2 to 1/2."""
        x = x.copy()
        spread = np.abs(x).max() or 1.0
        for end in np.array(self.layout.starts[1 : self.layout.results[0] + 2]) - 1:
            x[end] = abs(x[end])
            x[end - 1 : end] = x[end] * (1.25 * x[end - 1 : end] / spread - 0.75)
        return self.complete(x)

    def texts(self, x: Sequence[Fraction]) -> list[str]:
        """Return weights as decimals."""
        return list(map(quads.to_decimal, x))

    def _rows(self) -> list[tuple[list[int], int, list[int]]]:
        """Return the weights that follow, the one they follow from, and those of the point before.

        For each point from the third on.
        """
        rows = [list(range(*ends)) for ends in pairwise(self.layout.starts)]
        chain = []
        for before, now in pairwise(rows):
            *follow, lead = now[:-1] if len(now) > len(before) else now
            if len(now) >= len(before) and follow:
                chain.append((follow, lead, before))
        return chain
