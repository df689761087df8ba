"""Methods made of a method: transposed, flows the other way round."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from ...method.coefficients import Coefficient
from ...method.commutator_free import CommutatorFree
from ...method.flat import flat_order
from ...method.method import Method
from ...method.munthe_kaas import MuntheKaas
from ...method.tableau import Tableau
from ...structure.points import START, MethodError
from ...support.quads import to_decimal

__all__ = ["flat_tableau", "order_on_vector_spaces", "reversals", "transposed"]


def transposed(method: Method) -> Tableau | None:
    """Return the tableau whose a is transposed, if that is explicit and this one isn't."""
    if not isinstance(method, Tableau) or method.explicit:
        return None
    columns = list(zip(*method.entries, strict=True))
    try:
        return Tableau(columns, method.weights, explicit=True)
    except MethodError:
        return None


def reversals(method: Method) -> Iterator[tuple[str, Method]]:
    """Return methods whose flows are those of this one in reverse, and what is reversed."""
    if isinstance(method, CommutatorFree):
        if (backwards := _reversed_paths(method)) is not None:
            yield "the flows to each stage and to the result", backwards
    elif isinstance(method, Tableau) and method.explicit and method.stages > 1:
        rows = [row[:i] for i, row in enumerate(method.entries)]
        turned = [row[::-1] for row in rows]
        for what, a, b in (
            ("the rows of a and b", turned, method.weights[::-1]),
            ("the rows of a", turned, method.weights),
            ("b", rows, method.weights[::-1]),
        ):
            yield what, Tableau(a, b)


def _reversed_paths(method: CommutatorFree) -> CommutatorFree | None:
    """Return the method with the flows along each path in reverse; each path becomes a chain."""
    tree, weights = method.tree, method.point_coefficients
    points: list[tuple[int, dict[int, Coefficient]]] = []
    ends: dict[int, int] = {START: START}
    # of two stages the later one is at the later point, which needs the earlier one's field
    for end in sorted({*tree.stage_points, tree.result}):
        last = START
        for m in reversed(tree.path(end)):
            points.append((last, weights[m]))
            last = len(points) - 1
        ends[end] = last
    try:
        return CommutatorFree(points, [ends[at] for at in tree.stage_points], ends[tree.result])
    except MethodError:
        return None


def flat_tableau(method: Method) -> Tableau:
    """Return the tableau that a method is where flows commute.

    Sums of weights are off by what all of them are.
    """
    if isinstance(method, Tableau):
        return method
    if isinstance(method, MuntheKaas):
        return method.tableau
    units = [
        {stage: weight.unit for stage, weight in row.items()}
        for row in method.layout.point_weights(method.coefficients)
    ]

    def row(end: int) -> list[Coefficient]:
        sums = [Fraction(0)] * method.stages
        for m in method.tree.path(end):
            for stage, unit in units[m].items():
                sums[stage] += unit
        values = method.tree.flat_row(end)
        return [Coefficient(v, to_decimal(v), u) for v, u in zip(values, sums, strict=True)]

    return Tableau([row(at) for at in method.tree.stage_points], row(method.tree.result))


def order_on_vector_spaces(method: Method) -> int:
    """Return the order of a method where flows commute."""
    return flat_order(flat_tableau(method))
