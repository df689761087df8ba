"""Variants of a method: other coefficients, transposed tableau, reversed flows."""

from collections.abc import Iterator
from fractions import Fraction

from cg.construction.layouts.points import START, MethodError
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.flat import flat_order
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.methods.tableau import Tableau
from cg.support.quads import to_decimal


def transposed(method: Method) -> Tableau | None:
    """Return the tableau with a transposed if that is explicit and this one isn't, else None."""
    if not isinstance(method, Tableau) or method.explicit:
        return None
    columns = list(zip(*method.entries, strict=True))
    try:
        return Tableau(columns, method.weights, explicit=True)
    except MethodError:
        return None


def reversals(method: Method) -> Iterator[tuple[str, Method]]:
    """Yield methods with reversed flows, each with a description of the reversed part."""
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
    """Return the method with the flows of each path reversed; each path becomes a chain."""
    tree, weights = method.tree, method.point_coefficients
    points: list[tuple[int, dict[int, Coefficient]]] = []
    ends: dict[int, int] = {START: START}
    # in order of points, so that a path comes after those of the stages that it needs
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
    """Return the classical tableau to which a method reduces where flows commute."""
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
    """Return the order of a method on vector spaces, where flows commute."""
    return flat_order(flat_tableau(method))
