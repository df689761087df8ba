"""The change of one coefficient that restores the highest order, on manifolds or vector spaces.

Gauss–Newton steps of each coefficient alone solve the conditions of one order after another, until
no coefficient solves all of them. The first violated conditions are affine in most coefficients,
so that also large changes are found.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import isfinite, isqrt, log10
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import condition_trees, core_calls
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.method import Method
from cg.construction.methods.tolerance import TOLERANCE_FACTOR
from cg.construction.trees import OrderedTree, forest
from cg.support import quads
from cg.support.shared_numbers import ConditionOwner

_MAX_ORDER = 8  # sought; more takes long
_MAX_CHANGE = Fraction(1, 50)  # change for the sake of a single condition that counts as a misprint
_ALIGNED = 0.5  # largest part of the residuals that a step may leave
_QUAD_ROUNDING = 1e-30  # errors of coefficients that residuals in real(16) show
_MAX_STEPS = 12  # Gauss–Newton steps of one coefficient
_MAX_DENOMINATOR = 10**6  # largest one of fractions that are tried
_MAX_WIDTH = Fraction(1, 10**4)  # beyond, a fraction may be near to a coefficient by chance


@dataclass(frozen=True)
class Correction:
    """A change of one coefficient that solves all conditions to a higher order."""

    name: str  # name of the coefficient, such as a_6,3
    given: str  # its text
    value: str  # the text that it should have
    order: int  # with this value
    flat: bool  # whether that is the order on vector spaces only, where flows commute
    embedded: bool  # whether that is the order of the second result of a pair
    conditions: int  # number of violated conditions that the change solves


@np.errstate(all="ignore")  # huge coefficients overflow
def corrections(method: Method) -> tuple[Correction, ...]:
    """Return the changes of single coefficients that restore the highest order.

    The shortest texts, such as those of fractions, come first, then the smallest changes. Of
    pairs with a first result that no change improves, they are those of the second result.
    """
    kinds = (True,) if isinstance(method, MuntheKaas) else (False, True)
    owners = (ConditionOwner.FIRST_RESULT, ConditionOwner.SECOND_RESULT)
    for owner in owners[: len(method.layout.results)]:
        by_kind = [_highest(method, owner, flat) for flat in kinds]
        best = max(by_kind, key=lambda changes: changes[0].order if changes else 0)
        if best:
            return best
    return ()


def _highest(method: Method, owner: ConditionOwner, flat: bool) -> tuple[Correction, ...]:
    changes, violated, reached = dict.fromkeys(range(method.layout.size), Fraction()), 0, 0
    for order in range(1, _MAX_ORDER + 1):
        conditions = _Conditions(method, order, owner, flat)
        if conditions.violated:
            solving = {k: conditions.solved_by(k, start) for k, start in changes.items()}
            left = {k: change for k, change in solving.items() if change is not None}
            if not left:
                break
            changes, violated, reached = left, conditions.violated, order
    second, restoring = owner == ConditionOwner.SECOND_RESULT, []
    for k, change in sorted(changes.items(), key=lambda entry: abs(entry[1])):
        # many coefficients solve one condition
        if change and (violated > 1 or abs(change) <= _MAX_CHANGE):
            name, given = method.layout.names[k], method.coefficients[k]
            text = repr(float(given.value)) if "x" in given.text else given.text
            value = _restored_value(method, k, given.value + change)
            restoring.append(Correction(name, text, value, reached, flat, second, violated))
    return tuple(sorted(restoring, key=lambda one: len(one.value)))


def _restored_value(method: Method, k: int, value: Fraction) -> str:
    """Return a changed coefficient with as many digits as the others have, or as a fraction."""
    others = (float(x.unit) for j, x in enumerate(method.coefficients) if j != k)
    digits = min(round(1 - log10(max(others, default=0.0) or 1e-99)), quads.DECIMAL_DIGITS)
    close = Fraction(10) ** (7 - digits)  # some digits fewer, as the others are rounded too
    simple = value.limit_denominator(min(_MAX_DENOMINATOR, isqrt(int(1 / close)) // 10 + 1))
    near = close < _MAX_WIDTH and abs(simple - value) < close
    return str(simple) if near else quads.to_decimal(value, digits)


class _Conditions:
    """The conditions of a result through an order, as functions of one coefficient."""

    def __init__(self, method: Method, order: int, owner: ConditionOwner, flat: bool) -> None:
        trees = np.array(condition_trees(order, independent=not flat), dtype=np.intc)
        self._arguments = order, method.layout
        self._trees = trees, np.full_like(trees, owner)
        # where flows commute, sums of conditions are those of rooted trees
        self._shapes = _shapes(order) if flat else None
        self._x = [entry.value for entry in method.coefficients]
        self._bits, self._doubles = quads.encode(self._x), np.array(self._x, dtype=np.float64)
        self._given = residuals, jacobian = self._at(0, Fraction())
        units = TOLERANCE_FACTOR * np.array([float(entry.unit) for entry in method.coefficients])
        units += _QUAD_ROUNDING * (1 + abs(self._doubles))
        self._allowed = np.abs(jacobian) * units  # shares of the coefficients
        self.violated = int(np.sum(np.abs(residuals) > self._allowed.sum(axis=1)))

    def solved_by(self, k: int, change: Fraction) -> Fraction | None:
        """Return the change of coefficient k with which all hold, from a first guess, or None."""
        others = np.delete(self._allowed, k, axis=1).sum(axis=1)
        allowed = np.maximum(others, _QUAD_ROUNDING)
        for _ in range(_MAX_STEPS):
            residuals, jacobian = self._at(k, change) if change else self._given
            column = jacobian[:, k]
            step = -float(column @ residuals / (column @ column))
            if not isfinite(step):
                return None
            change += Fraction(step)
            if (np.abs(residuals) <= allowed).all():
                return change
            left = np.linalg.norm(residuals + column * step)
            if not left < _ALIGNED * np.linalg.norm(residuals):
                return None
        return None

    def _at(self, k: int, change: Fraction) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the residuals and their Jacobian with a change of coefficient k."""
        bits, doubles = self._bits.copy(), self._doubles.copy()
        bits[k], doubles[k] = quads.encode([self._x[k] + change])[0], self._x[k] + change
        residuals = core_calls.residuals(*self._arguments, bits, *self._trees)
        jacobian = core_calls.jacobian(*self._arguments, doubles, *self._trees)
        if self._shapes is not None:  # sums cancel, so that they need all digits
            sums = _sums(np.array(quads.decode(residuals)), self._shapes)
            residuals, jacobian = quads.encode(sums.tolist()), _sums(jacobian, self._shapes)
        return quads.to_float(residuals), jacobian


def _sums(values: NDArray[Any], shapes: list[int]) -> NDArray[Any]:
    sums = np.zeros((max(shapes) + 1, *values.shape[1:]), values.dtype)
    np.add.at(sums, shapes, values)
    return sums


@cache
def _shapes(order: int) -> list[int]:
    """Return for each ordered tree the index of its shape, in which children have no order."""
    indices: dict[object, int] = {}
    shapes = [_unordered(forest(order + 1).tree(k)) for k in condition_trees(order)]
    return [indices.setdefault(shape, len(indices)) for shape in shapes]


def _unordered(tree: OrderedTree) -> tuple[Any, ...]:
    return tuple(sorted(map(_unordered, tree.children)))
