"""A step of an explicit method as a short program, the same in every language.

A step keeps points in slots; slot 0 is the initial point. Its moves are flows from one slot to
another, and between them f is evaluated at a slot, stage by stage. Chains of flows take one slot.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

from ..method.munthe_kaas import MuntheKaas
from ..structure.points import START, Point, PointTree, tree_of_flat_rows
from .digits import Numbers

__all__ = ["Move", "Program", "identifier", "make_program"]


@dataclass(frozen=True)
class Move:
    """A flow from the point in one slot to the one in another.

    Attributes
    ----------
    origin, target : int
        Slots; they are the same if the point that it starts from isn't needed any more.
    terms : tuple of pairs
        Stages (from 0) and the decimal numbers that their coefficients are multiplied by.
    """

    origin: int
    target: int
    terms: tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Program:
    """What a step does.

    Attributes
    ----------
    name : str
        An identifier of all languages, in lower case.
    title : str
        What the method is, in one line.
    source : str
        Where it is from.
    slots : int
        Number of slots.
    moves : tuple of Move
    before : tuple of int
        How many moves come before each stage is evaluated; the rest follow the last stage.
    stage_slots : tuple of int
        Where each stage is evaluated.
    c : tuple of str
        Abscissae.
    result : int
        The slot of the result; of a pair the one of higher order.
    second : int or None
        The slot of the other result of a pair whose results are compared.
    errors : tuple of tuples of str
        Weights of the stages in each error estimate of a pair that needs no second result.
    on_algebra : bool
        Whether coefficients at stages become derivatives of coordinates, by dexp⁻¹.
    """

    name: str
    title: str
    source: str
    slots: int
    moves: tuple[Move, ...]
    before: tuple[int, ...]
    stage_slots: tuple[int, ...]
    c: tuple[str, ...]
    result: int
    second: int | None
    errors: tuple[tuple[str, ...], ...]
    on_algebra: bool

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.c)

    @property
    def first_term(self) -> tuple[int, ...]:
        """Where the terms of each move begin among all, and their number last."""
        starts = [0]
        for move in self.moves:
            starts.append(starts[-1] + len(move.terms))
        return tuple(starts)

    @property
    def term_stages(self) -> tuple[int, ...]:
        """The stages of all terms."""
        return tuple(stage for move in self.moves for stage, _ in move.terms)

    @property
    def term_weights(self) -> tuple[str, ...]:
        """The weights of all terms."""
        return tuple(weight for move in self.moves for _, weight in move.terms)


def identifier(name: str) -> str:
    """Return a name as an identifier in lower case, such as ``cg3_2`` for CG3(2).

    Examples
    --------
    >>> identifier("RKMK8(5,3)"), identifier("4th order"), identifier("")
    ('rkmk8_5_3', 'method_4th_order', 'method')
    """
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    if not plain or plain[0].isdigit():
        plain = f"method_{plain}".strip("_")
    return plain[:40].rstrip("_")


def make_program(numbers: Numbers, title: str) -> Program:
    """Return the step of an explicit method.

    Raises
    ------
    ValueError
        If the method is implicit.
    """
    method = numbers.method
    if not method.explicit:
        raise ValueError(
            f"format must be json, toml or latex for an implicit method, whose step isn't a "
            f"sequence of flows; {method.name or 'this one'} is"
        )
    tree, errors = _tree(numbers)
    tree = _without_repetitions(tree)
    order, before = _sequence(tree)
    slots, count = _slots(tree, order, before)
    moves = tuple(
        Move(
            slots[tree.points[m].parent],
            slots[m],
            tuple((k, numbers.decimal(w)) for k, w in tree.points[m].weights.items()),
        )
        for m in order
    )
    c = [sum(tree.flat_row(at), Fraction(0)) for at in tree.stage_points]
    second = tree.embedded_result
    return Program(
        identifier(method.name),
        title,
        method.source,
        count,
        moves,
        before,
        tuple(slots[at] for at in tree.stage_points),
        tuple(map(numbers.decimal, c)),
        slots[tree.result],
        None if second is None else slots[second],
        tuple(tuple(map(numbers.decimal, row)) for row in errors),
        isinstance(method, MuntheKaas),
    )


def _tree(numbers: Numbers) -> tuple[PointTree, list[list[Fraction]]]:
    """Return the points of a step that leads to the better result, and weights of errors."""
    method = numbers.method
    third = getattr(method, "third_weights", None)
    better = (method.embedded_order or 0) > method.order
    if isinstance(method, MuntheKaas):
        rows = [list(map(Fraction, row)) for row in method.layout.full_rows(numbers.values)]
        b, *others = rows[method.stages :]
        if better:
            b, others = others[0], [b]
        if third is not None:
            others.append([weight.value for weight in third])
        errors = [[x - y for x, y in zip(b, other, strict=True)] for other in others]
        return tree_of_flat_rows(rows[: method.stages], b), errors
    tree = method.layout.tree(numbers.values)
    result, second = tree.result, tree.embedded_result
    if better and second is not None:
        result, second = second, result
    if not method.error_weights:
        return PointTree(tree.points, tree.stage_points, result, second), []
    assert tree.embedded_result is not None
    flow = tree.points[tree.embedded_result].weights
    errors = [[-flow.get(k, Fraction(0)) for k in range(method.stages)]]
    if third is not None:
        sums = tree.flat_row(tree.result)
        errors.append([x - weight.value for x, weight in zip(sums, third, strict=True)])
    return PointTree(tree.points, tree.stage_points, result), errors


def _without_repetitions(tree: PointTree) -> PointTree:
    """Return the tree with points that are the same made one."""
    same = tree.merged
    points = tuple(Point(same[point.parent], point.weights) for point in tree.points)
    second = tree.embedded_result
    return PointTree(
        points,
        tuple(same[at] for at in tree.stage_points),
        same[tree.result],
        None if second is None else same[second],
    )


def _sequence(tree: PointTree) -> tuple[list[int], tuple[int, ...]]:
    """Return the points in the order in which they are needed, and how many before each stage."""
    order: dict[int, None] = {}  # a set that keeps its order

    def lead_to(end: int) -> None:
        order.update(dict.fromkeys(tree.path(end)))

    before = []
    for at in tree.stage_points:
        lead_to(at)
        before.append(len(order))
    lead_to(tree.result)
    if tree.embedded_result is not None:
        lead_to(tree.embedded_result)
    return list(order), tuple(before)


def _slots(
    tree: PointTree, order: list[int], before: tuple[int, ...]
) -> tuple[dict[int, int], int]:
    """Return the slot of each point, and how many there are.

    A slot is used again when no move, stage or result needs its point any more.
    """
    last: dict[int, int] = {}
    for k, m in enumerate(order):
        last[tree.points[m].parent] = k
    for at, count in zip(tree.stage_points, before, strict=True):
        last[at] = max(last.get(at, 0), count)
    for end in (tree.result, tree.embedded_result):
        if end is not None:
            last[end] = len(order)
    last[START] = len(order)
    slots = {START: 0}
    free: list[int] = []
    count = 1
    ended: dict[int, list[int]] = {}
    for k, m in enumerate(order):
        free.extend(slots[other] for other in ended.pop(k, ()))
        parent = slots[tree.points[m].parent]
        if parent in free:
            slots[m] = parent
            free.remove(parent)
        elif free:
            slots[m] = free.pop()
        else:
            slots[m] = count
            count += 1
        ended.setdefault(last[m], []).append(m)
    return slots, count
