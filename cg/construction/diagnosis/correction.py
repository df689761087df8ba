"""The one coefficient whose correction raises the order, for methods that no catalogue has.

If entry k is wrong by -δ, the residuals of the conditions are ``r = -J_k δ`` up to O(δ²), with the
column J_k of their Jacobian. Gauss–Newton steps ``-J_k·r / J_k·J_k`` solve the conditions of one
order after another for each entry alone, until none of the entries solves all of them.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import factorial, isfinite, isqrt, log10, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import MAX_ORDER, condition_trees, core_calls
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.methods.tolerance import TOLERANCE_FACTOR, to_floats
from cg.construction.trees.ordered import OrderedTree, forest
from cg.support import quads
from cg.support.shared_numbers import ConditionOwner

_LARGEST = Fraction(1, 50)  # change that counts as a misprint
_ALIGNED = 0.5  # largest part of the residuals that a first step may leave
_ROUNDING = 1e-30  # of residuals in real(16), relative to their sensitivity to coefficients
_MAX_STEPS = 12
_MAX_DENOMINATOR = 10**6


@dataclass(frozen=True)
class Correction:
    """A name, the coefficient, the one that solves the conditions, and the order it leads to."""

    name: str
    given: Coefficient
    value: Coefficient
    order: int
    conditions: int  # the number of violated conditions that it solves


def corrections(method: Method) -> list[Correction]:
    """Return corrections of single coefficients that raise an order the most.

    The shortest texts, such as those of fractions, come first, then the smallest changes. Of
    pairs with a first result that no correction improves, they are those of the second result.
    """
    results = [(ConditionOwner.FIRST_RESULT, method.exact_order)]
    if method.embedded_order is not None:
        results.append((ConditionOwner.SECOND_RESULT, method.embedded_order))
    for owner, order in results:
        ends, reached = dict.fromkeys(range(method.layout.size), Fraction()), order
        violated = 0
        for higher in range(order + 1, MAX_ORDER + 1):
            conditions = _Conditions(method, higher, owner)
            left = dict(conditions.solved_by(ends))
            if not left:
                break
            ends, reached, violated = left, higher, conditions.violated
        if reached > order:
            return _corrections(method, ends, reached, violated)
    return []


def _corrections(
    method: Method, ends: dict[int, Fraction], order: int, violated: int
) -> list[Correction]:
    found = []
    for k, change in ends.items():
        given = method.coefficients[k]
        value = given.value + change
        unit = max((float(x.unit) for x in method.coefficients if x is not given), default=0.0)
        digits = min(round(1 - log10(unit or 1e-99)), quads.DECIMAL_DIGITS)
        close = Fraction(10) ** (5 - digits)
        simple = value.limit_denominator(min(_MAX_DENOMINATOR, isqrt(int(1 / close)) // 10 + 1))
        text = str(simple) if abs(simple - value) < close else quads.to_decimal(value, digits)
        name = method.layout.names[k]
        found.append(Correction(name, given, Coefficient.read(text), order, violated))
    return sorted(
        found, key=lambda one: (len(one.value.text), abs(one.value.value - one.given.value))
    )


class _Conditions:
    """The conditions of a result through an order, as functions of one coefficient."""

    def __init__(self, method: Method, order: int, owner: ConditionOwner) -> None:
        self._flat = _flat_conditions(order) if isinstance(method, MuntheKaas) else None
        trees = np.array(condition_trees(order, self._flat is None), dtype=np.intc)
        self._arguments = order, method.layout
        self._trees = trees, np.full(trees.size, owner, dtype=np.intc)
        self._x = [entry.value for entry in method.coefficients]
        self._residuals, self._jacobian = self._residuals_at(self._x), self._jacobian_at(self._x)
        units = to_floats([Coefficient(x.unit, "", x.unit) for x in method.coefficients])
        units = TOLERANCE_FACTOR * units + _ROUNDING * (1 + abs(to_floats(method.coefficients)))
        self._allowed = np.abs(self._jacobian) * units  # shares of the coefficients
        self.violated = int(np.sum(np.abs(self._residuals) > self._allowed.sum(axis=1)))

    def solved_by(self, starts: dict[int, Fraction]) -> Iterator[tuple[int, Fraction]]:
        """Yield the entries that solve the conditions, with their changes."""
        for k, start in starts.items():
            column, r = self._jacobian[:, k], self._residuals
            step = _step(column, r)
            if step and np.linalg.norm(r + column * step) < _ALIGNED * np.linalg.norm(r):
                change = self._solve(k, start or Fraction(step))
                if change is not None:
                    yield k, change

    def _solve(self, k: int, change: Fraction) -> Fraction | None:
        smallest, others = np.inf, np.delete(self._allowed, k, axis=1).sum(axis=1)
        allowed = np.maximum(others, _ROUNDING)
        for _ in range(_MAX_STEPS):
            x = [*self._x[:k], self._x[k] + change, *self._x[k + 1 :]]
            r = self._residuals_at(x)
            left = float(np.max(np.abs(r) / allowed))
            if abs(change) > _LARGEST or not left < smallest:
                return None
            if left <= 1:
                return change + Fraction(_step(self._jacobian_at(x)[:, k], r))
            smallest = left
            change += Fraction(_step(self._jacobian_at(x)[:, k], r))
        return None

    def _residuals_at(self, x: list[Fraction]) -> NDArray[np.float64]:
        bits = quads.encode(x)
        residuals = core_calls.residuals(*self._arguments, bits, *self._trees)
        if self._flat is None:
            return quads.to_float(residuals)
        return _summed(np.array(quads.decode(residuals)), *self._flat).astype(np.float64)

    def _jacobian_at(self, x: list[Fraction]) -> NDArray[np.float64]:
        jac = core_calls.jacobian(*self._arguments, np.array(x, dtype=np.float64), *self._trees)
        return jac if self._flat is None else _summed(jac, *self._flat)


def _step(column: NDArray[np.float64], residuals: NDArray[np.float64]) -> float:
    """Return the step of one unknown that reduces the residuals the most."""
    with np.errstate(all="ignore"):  # of huge coefficients
        step = -float(column @ residuals / (column @ column))
    return step if isfinite(step) else 0.0


@cache
def _flat_conditions(order: int) -> tuple[list[int], list[int]]:
    """Return for each condition the sum that it belongs to, and how often.

    The sums are over all orders of the children of nodes. Where flows commute, they are the
    conditions of rooted trees.
    """
    shapes: dict[object, int] = {}
    trees = [_unordered(forest(order + 1).tree(k)) for k in condition_trees(order)]
    places = [shapes.setdefault(shape, len(shapes)) for shape, _ in trees]
    return places, [number for _, number in trees]


def _summed(values: NDArray[Any], places: list[int], numbers: list[int]) -> NDArray[Any]:
    """Return the sums of `_flat_conditions` over the first axis."""
    sums = np.zeros((max(places) + 1, *values.shape[1:]), values.dtype)
    np.add.at(sums, places, (values.T * np.array(numbers)).T)
    return sums


def _unordered(tree: OrderedTree) -> tuple[object, int]:
    """Return the tree with sorted children, and the permutations of children that leave it."""
    parts = sorted(map(_unordered, tree.children), key=repr)
    shapes = tuple(shape for shape, _ in parts)
    repeated = prod(map(factorial, Counter(shapes).values()))
    return shapes, repeated * prod(number for _, number in parts)
