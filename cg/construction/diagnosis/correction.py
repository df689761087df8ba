"""The change of one coefficient, or an exchange of neighbours, that restores the highest order.

The order is that on manifolds or on vector spaces, whichever becomes higher.

If entry k is wrong by -δ, the residuals of the conditions are ``r = -J_k δ`` up to O(δ²), with the
column J_k of their Jacobian. Gauss–Newton steps ``-J_k·r / J_k·J_k`` solve the conditions of one
order after another for each entry alone, until none of the entries solves all of them. The first
violated conditions are affine in most entries, so that also large changes are found.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import factorial, isfinite, isqrt, log10, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import condition_trees, core_calls
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.method import Method
from cg.construction.methods.tolerance import TOLERANCE_FACTOR, to_floats
from cg.construction.trees import OrderedTree, forest
from cg.support import quads
from cg.support.shared_numbers import ConditionOwner

_MAX_ORDER = 8  # sought; more takes long
_MAX_CHANGE = Fraction(1, 50)  # change for the sake of a single condition that counts as a misprint
_ALIGNED = 0.5  # largest part of the residuals that a first step may leave
_QUAD_ROUNDING = 1e-30  # errors of coefficients that residuals in real(16) show
_MAX_STEPS = 12  # Gauss–Newton steps of one entry
_MAX_DENOMINATOR = 10**6  # largest one of fractions that are tried


@dataclass(frozen=True)
class Correction:
    """A change of one coefficient, or an exchange, that solves all conditions to a higher order.

    Attributes
    ----------
    name
        Name of the coefficient, such as ``a_6,3``, or of the two that are exchanged.
    given
        Its text, or both.
    value
        The text that it should have, or both.
    order
        Order with this value.
    flat
        Whether that is the order on vector spaces only, where flows commute.
    embedded
        Whether that is the order of the second result of a pair.
    conditions
        Number of violated conditions that the change solves.
    """

    name: str
    given: str
    value: str
    order: int
    flat: bool
    embedded: bool
    conditions: int


@np.errstate(all="ignore")  # huge coefficients overflow
def corrections(method: Method) -> tuple[Correction, ...]:
    """Return the changes of single coefficients, or else exchanges, that restore the highest order.

    The shortest texts, such as those of fractions, come first, then the smallest changes. Of
    pairs with a first result that no change improves, they are those of the second result.
    """
    for owner in (ConditionOwner.FIRST_RESULT, ConditionOwner.SECOND_RESULT):
        if owner == ConditionOwner.FIRST_RESULT or method.embedded_order is not None:
            kinds = (True,) if isinstance(method, MuntheKaas) else (False, True)
            restoring = [_highest(method, owner, flat) for flat in kinds]
            restoring += [_exchanged(method, owner, flat) for flat in kinds]
            best = max(restoring, key=lambda changes: changes[0].order if changes else 0)
            if best:
                return best
    return ()


def _exchanged(method: Method, owner: ConditionOwner, flat: bool) -> tuple[Correction, ...]:
    """Return the exchanges of two neighbours in a row or a column that restore the most."""
    names, values = method.layout.names, [entry.value for entry in method.coefficients]
    entries: dict[tuple[Any, ...], int] = {
        (re.sub(r"\d+", "#", name), *map(int, re.findall(r"\d+", name))): k
        for k, name in enumerate(names)
    }
    pairs = []
    for (kind, *indices), k in entries.items():
        for axis in range(len(indices)):
            j = entries.get((kind, *(n + (axis == i) for i, n in enumerate(indices))))
            if j is not None and values[j] != values[k]:
                pairs.append((k, j))
    violated, reached = 0, 0
    for order in range(1, _MAX_ORDER + 1):
        conditions = _Conditions(method, order, owner, flat)
        if conditions.violated:
            left = [pair for pair in pairs if conditions.hold_with(*pair)]
            if not left:
                break
            pairs, violated, reached = left, conditions.violated, order
    if not violated:
        return ()
    texts = [short(entry) for entry in method.coefficients]
    return tuple(
        Correction(
            f"{names[k]}, {names[j]}", f"{texts[k]}, {texts[j]}", f"{texts[j]}, {texts[k]}",
            reached, flat, owner == ConditionOwner.SECOND_RESULT, violated,
        )
        for k, j in pairs
    )  # fmt: skip


def _highest(method: Method, owner: ConditionOwner, flat: bool) -> tuple[Correction, ...]:
    ends, violated, reached = dict.fromkeys(range(method.layout.size), Fraction()), 0, 0
    for order in range(1, _MAX_ORDER + 1):
        conditions = _Conditions(method, order, owner, flat)
        if conditions.violated:
            left = dict(conditions.solved_by(ends))
            if not left:
                break
            ends, violated, reached = left, conditions.violated, order
    changes = [(k, change) for k, change in ends.items() if change]
    if violated == 1:  # many coefficients solve one condition
        changes = [(k, change) for k, change in changes if abs(change) <= _MAX_CHANGE]
    texts = [(_text(method, k, change), abs(change), k) for k, change in changes]
    names, second = method.layout.names, owner == ConditionOwner.SECOND_RESULT
    return tuple(
        Correction(names[k], short(method.coefficients[k]), text, reached, flat, second, violated)
        for text, _, k in sorted(texts, key=lambda entry: (len(entry[0]), entry[1]))
    )


def _text(method: Method, k: int, change: Fraction) -> str:
    """Return a changed coefficient with as many digits as the others have, or as a fraction."""
    value = method.coefficients[k].value + change
    others = (float(x.unit) for j, x in enumerate(method.coefficients) if j != k)
    digits = min(round(1 - log10(max(others, default=0.0) or 1e-99)), quads.DECIMAL_DIGITS)
    close = Fraction(10) ** (7 - digits)
    simple = value.limit_denominator(min(_MAX_DENOMINATOR, isqrt(int(1 / close)) // 10 + 1))
    return str(simple) if abs(simple - value) < close else quads.to_decimal(value, digits)


def short(coefficient: Coefficient) -> str:
    """Return the text of a coefficient, of a double the decimal one."""
    text = coefficient.text
    return repr(float(coefficient.value)) if "x" in text else text


class _Conditions:
    """The conditions of a result through an order, as functions of one coefficient."""

    def __init__(self, method: Method, order: int, owner: ConditionOwner, flat: bool) -> None:
        self._flat = _flat_conditions(order) if flat else None
        trees = np.array(condition_trees(order, self._flat is None), dtype=np.intc)
        self._arguments = order, method.layout
        self._trees = trees, np.full(trees.size, owner, dtype=np.intc)
        self._x = [entry.value for entry in method.coefficients]
        self._bits, self._floats = quads.encode(self._x), np.array(self._x, dtype=np.float64)
        self._residuals, self._jacobian = self._residuals_at(), self._jacobian_at()
        units = to_floats([Coefficient(x.unit, "", x.unit) for x in method.coefficients])
        units = TOLERANCE_FACTOR * units + _QUAD_ROUNDING * (
            1 + abs(to_floats(method.coefficients))
        )
        self._allowed = np.abs(self._jacobian) * units  # shares of the coefficients
        self.violated = int(np.sum(np.abs(self._residuals) > self._allowed.sum(axis=1)))

    def solved_by(self, starts: dict[int, Fraction]) -> Iterator[tuple[int, Fraction]]:
        """Yield the entries that solve the conditions, with their changes."""
        for k, start in starts.items():
            column, r = self._jacobian[:, k], self._residuals
            step = _step(column, r)
            if start or np.linalg.norm(r + column * step) < _ALIGNED * np.linalg.norm(r):
                change = self._solve(k, start or Fraction(step))
                if change is not None:
                    yield k, change

    def _solve(self, k: int, change: Fraction) -> Fraction | None:
        smallest, others = np.inf, np.delete(self._allowed, k, axis=1).sum(axis=1)
        allowed = np.maximum(others, _QUAD_ROUNDING)
        for _ in range(_MAX_STEPS):
            r = self._residuals_at(k, change)
            left = float(np.max(np.abs(r) / allowed))
            if not left < smallest:
                return None
            smallest = left
            change += Fraction(_step(self._jacobian_at(k, change)[:, k], r))
            if left <= 1:
                return change
        return None

    def hold_with(self, k: int, j: int) -> bool:
        """Return whether all hold if two entries are exchanged."""
        self._bits[[k, j]] = self._bits[[j, k]]
        left = np.abs(self._residuals_at())
        self._bits[[k, j]] = self._bits[[j, k]]
        return bool((left <= np.maximum(self._allowed.sum(axis=1), _QUAD_ROUNDING)).all())

    def _residuals_at(
        self, k: int | None = None, change: Fraction = Fraction()
    ) -> NDArray[np.float64]:
        bits = self._bits.copy()
        if k is not None:
            bits[k] = quads.encode([self._x[k] + change])[0]
        residuals = core_calls.residuals(*self._arguments, bits, *self._trees)
        if self._flat is None:
            return quads.to_float(residuals)
        summed = _summed(np.array(quads.decode(residuals)), *self._flat)
        return quads.to_float(quads.encode(summed.tolist()))

    def _jacobian_at(self, k: int = 0, change: Fraction = Fraction()) -> NDArray[np.float64]:
        x = self._floats.copy()
        x[k] = self._x[k] + change
        jac = core_calls.jacobian(*self._arguments, x, *self._trees)
        return jac if self._flat is None else _summed(jac, *self._flat)


def _step(column: NDArray[np.float64], residuals: NDArray[np.float64]) -> float:
    """Return the step of one unknown that reduces the residuals the most."""
    step = -float(column @ residuals / (column @ column))
    return step if isfinite(step) else 0.0


@cache
def _flat_conditions(order: int) -> tuple[list[int], list[int]]:
    """Return for each condition the index of its sum, and how often it occurs there.

    The sums are over all orders of the children of nodes. Where flows commute, they are the
    conditions of rooted trees.
    """
    shapes: dict[object, int] = {}
    trees = [_unordered(forest(order + 1).tree(k)) for k in condition_trees(order)]
    indices = [shapes.setdefault(shape, len(shapes)) for shape, _ in trees]
    return indices, [multiplicity for _, multiplicity in trees]


def _summed(values: NDArray[Any], indices: list[int], multiplicities: list[int]) -> NDArray[Any]:
    """Return the sums of `_flat_conditions` over the first axis."""
    sums = np.zeros((max(indices) + 1, *values.shape[1:]), values.dtype)
    np.add.at(sums, indices, (values.T * np.array(multiplicities)).T)
    return sums


def _unordered(tree: OrderedTree) -> tuple[object, int]:
    """Return the tree with sorted children, and the permutations of children that keep the tree."""
    parts = sorted(map(_unordered, tree.children), key=repr)
    shapes = tuple(shape for shape, _ in parts)
    repeated = prod(map(factorial, Counter(shapes).values()))
    return shapes, repeated * prod(number for _, number in parts)
