"""Coefficients and abscissae that keep given values while the others are solved for.

Each is a linear equation in the unknowns x: ``a[3,1]`` is one of them, ``c[3]`` the sum of a row.
Elimination in rational arithmetic writes one unknown of each equation, its pivot, in terms of the
free ones, ``x_p = d_p - Σ m_pk x_k``. Solvers move the free ones only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.layouts import Layout
from cg.construction.methods.coefficients import Coefficient
from cg.construction.points import START
from cg.support import quads

Hold = tuple[tuple[str, str], ...]
"""Names and rational values as text, as settings store them."""


def plain_name(label: str, name: Any) -> str:
    """Return a name like ``a_2,1``, which may be given as ``a[2,1]``."""
    if not isinstance(name, str) or not name:
        raise TypeError(f"{label} must have names like 'a[2,1]', got {name!r}")
    return name.replace(" ", "").replace("[", "_").rstrip("]")


def read_hold(hold: Any) -> Hold:
    """Return names like ``a_2,1``, which may be given as ``a[2,1]``, and their values."""
    if not isinstance(hold, Mapping) or not all(isinstance(name, str) for name in hold):
        raise TypeError(f"hold must be a mapping from names like 'a[2,1]' to numbers, got {hold!r}")
    values: dict[str, str] = {}
    for name, number in hold.items():
        try:
            value = str(Coefficient.read(number).value)
        except ValueError as error:
            raise ValueError(f"hold: {name}: {error}") from None
        key = plain_name("hold", name)
        if values.setdefault(key, value) != value:
            raise ValueError(f"hold must give {name} one value, got {values[key]} and {value}")
    return tuple(sorted(values.items()))


@dataclass(frozen=True, eq=False)
class HeldValues:
    """The eliminated equations: ``rows[:, :-1] @ x = rows[:, -1]``, the identity at `pivots`."""

    pivots: NDArray[np.intp]
    rows: NDArray[Any]  # Fractions, shape (pivots, size + 1)

    @classmethod
    def of(cls, hold: Hold, layout: Layout, zeros: Sequence[int] = ()) -> HeldValues:
        """Eliminate the equations of a layout, whose unknowns `zeros` are zero."""
        unknowns = {name: [k] for k, name in enumerate(layout.names)}
        unknowns |= {f"c_{r + 1}": layout.row(r) for r in range(layout.stages)}
        equations = [*((layout.names[k], "0") for k in zeros), *hold]
        for name, _ in equations:
            if name not in unknowns:
                raise ValueError(
                    f"hold must name unknowns, {', '.join(layout.names)}, or abscissae c_1 to "
                    f"c_{layout.stages}, got {name}"
                )
        try:
            return cls.solving(
                [(unknowns[k], Fraction(value)) for k, value in equations], layout.size
            )
        except ArithmeticError as error:
            name, value = equations[error.args[1]]
            text = f"hold: {name} = {value} contradicts what else is held or zero"
            raise ValueError(text) from None

    @classmethod
    def solving(cls, sums: Iterable[tuple[Iterable[int], Fraction]], size: int) -> HeldValues:
        """Solve sums of unknowns for the last unknown of each; ArithmeticError if none solve them.

        The rows are the reduced echelon form with columns in reverse order.
        """
        rows: dict[int, NDArray[Any]] = {}
        for number, (indices, value) in enumerate(sums):
            row = np.full(size + 1, Fraction())
            row[list(indices)], row[-1] = Fraction(1), value
            for k, other in rows.items():
                row = row - row[k] * other if row[k] else row
            last = max(np.flatnonzero(row[:-1]).tolist(), default=None)
            if last is not None:
                row = row / row[last]
                rows = {k: o - o[last] * row if o[last] else o for k, o in rows.items()}
                rows[last] = row
            elif row[-1]:
                raise ArithmeticError("sums contradict each other", number)
        matrix = np.array(list(rows.values()), dtype=object).reshape(-1, size + 1)
        return cls(np.array(list(rows), dtype=np.intp), matrix)

    @cached_property
    def _floats(self) -> NDArray[np.float64]:
        return self.rows.astype(np.float64)

    @property
    def dependent(self) -> bool:
        """Whether a pivot changes with the free unknowns."""
        return bool(np.count_nonzero(self.rows[:, :-1]) > len(self.pivots))

    def complete(self, x: Any) -> NDArray[Any]:
        """Return x, doubles or Fractions, with the pivots that its free unknowns determine."""
        x = np.array(x)
        rows = self.rows if x.dtype == object else self._floats
        x[self.pivots] *= 0
        x[self.pivots] = rows[:, -1] - rows[:, :-1] @ x
        return np.asarray(x)

    def derivatives(self, jac: NDArray[np.float64], x: Any = None) -> NDArray[np.float64]:
        """Return derivatives at x, shape (m, size), by the free unknowns; 0 for pivots."""
        return np.asarray(jac - jac[:, self.pivots] @ self._floats[:, :-1])

    def texts(self, x: Sequence[Fraction]) -> list[str]:
        """Return unknowns as decimals, those that are held themselves as rationals."""
        texts = list(map(quads.to_decimal, x))
        for p, row in zip(self.pivots.tolist(), self.rows, strict=True):
            if np.count_nonzero(row[:-1]) == 1:
                texts[p] = str(row[-1])
        return texts


def register_chain(stages: int, order: int, pair: bool) -> Layout:
    """Return the points of a two-register method; up to order three a pair has a stage at its end.

    To the second result of a pair of order three lead two flows from the start of the step, which a
    step that may be rejected stores anyway: along the register at the end, and along the field at
    the result, with which the next step begins. From order four on there is no such pair; one flow
    along the register leads there from the point after the second stage. From the result itself
    such flows would see nothing of errors by commutators in ``F(t) = X + t V``: the register and
    the field are parallel there.

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
    """The weights that the free weights of a chain determine, in place of `HeldValues`.

    Point m of the chain is reached along ``h B_m Z_m`` with ``Z_m = A_m Z_(m-1) + F_m``, so that
    its weights w are those before it times one number, but the last one:

        w_m,k = w_m,m-1 w_(m-1),k / w_(m-1),m-1 for k < m - 1,

    with stages counted as points are. Solvers move w_m,m = B_m and w_m,m-1 = A_m B_m, and the other
    weights follow.
    """

    layout: Layout
    dependent = True

    @cached_property
    def pivots(self) -> NDArray[np.intp]:
        """The weights that follow from others."""
        return np.array([k for dependents, _, _ in self._rows() for k in dependents], dtype=np.intp)

    def complete(self, x: Any) -> NDArray[Any]:
        """Return weights, doubles or Fractions, with those that follow; not finite for B = 0."""
        x = np.array(x)
        if x.dtype == object and any(x[before[-1]] == 0 for _, _, before in self._rows()):
            raise ZeroDivisionError("B must not be 0, or the next stage repeats the one before it")
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for dependents, lead, before in self._rows():
                x[dependents] = x[lead] / x[before[-1]] * x[before[:-1]]
        return np.asarray(x)

    def derivatives(self, jac: NDArray[np.float64], x: Any) -> NDArray[np.float64]:
        """Return derivatives at x, shape (m, size), by the free weights; 0 for others."""
        along, x = np.eye(self.layout.size), self.complete(x)
        along[self.pivots] = 0.0
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for dependents, lead, (*others, last) in self._rows():
                ratio = x[lead] / x[last]
                change = (along[lead] - ratio * along[last]) / x[last]
                along[dependents] = np.outer(x[others], change) + ratio * along[others]
            return np.asarray(jac @ along)

    def guess(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return likely weights from random ones: B positive, A from -2 to 1/2."""
        x = x.copy()
        spread = np.abs(x).max() or 1.0
        for end in np.array(self.layout.starts[1 : self.layout.results[0] + 2]) - 1:
            x[end] = abs(x[end])
            x[end - 1 : end] = x[end] * (1.25 * x[end - 1 : end] / spread - 0.75)
        return self.complete(x)

    def _rows(self) -> list[tuple[list[int], int, list[int]]]:
        """Return the weights that follow, the one they follow from, and those of the point before.

        For each point from the third on.
        """
        rows = [list(range(*ends)) for ends in pairwise(self.layout.starts)]
        chain = []
        for before, now in pairwise(rows):
            *dependents, lead = now[:-1] if len(now) > len(before) else now
            if len(now) >= len(before) and dependents:
                chain.append((dependents, lead, before))
        return chain
