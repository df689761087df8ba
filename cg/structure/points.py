"""Trees of points: what a method does on a manifold, flow by flow."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import Any

__all__ = [
    "START",
    "MethodError",
    "Point",
    "PointTree",
    "check_tree",
    "points_of",
    "tree_of_flat_rows",
    "tree_of_rows",
]

START = -1
"""The index of the point that a step starts from."""


class MethodError(ValueError):
    """Points or coefficients don't make a method; the message names what is at fault.

    Examples
    --------
    >>> import cg
    >>> try:
    ...     cg.CommutatorFree([(0, {0: 1})], [-1], 0)
    ... except cg.MethodError as error:
    ...     print(error)
    the parent of point 0 must come before it, or there is a cycle, got 0
    """


@dataclass(frozen=True, eq=False)
class Point:
    r"""A point of a step: the flow of a combination of frozen fields from an earlier point.

    .. math:: y_m = \exp\Bigl(h \sum_k \alpha_{m,k} F_k\Bigr) y_{\mathrm{parent}(m)}

    Attributes
    ----------
    parent : int
        Index of the point that the flow starts from, `START` for the initial point.
    weights : mapping from int to Fraction
        The numbers α by the stages (from 0) whose fields they multiply, none of them zero.
    """

    parent: int
    weights: Mapping[int, Fraction]

    def __post_init__(self) -> None:
        ordered = {k: self.weights[k] for k in sorted(self.weights) if self.weights[k] != 0}
        object.__setattr__(self, "weights", MappingProxyType(ordered))

    @property
    def _key(self) -> tuple[int, tuple[tuple[int, Fraction], ...]]:
        return self.parent, tuple(self.weights.items())

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Point) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    def __repr__(self) -> str:
        weights = ", ".join(f"{stage}: {weight}" for stage, weight in self.weights.items())
        return f"Point({self.parent}, {{{weights}}})"

    def __reduce__(self) -> tuple[type[Point], tuple[int, dict[int, Fraction]]]:
        return Point, (self.parent, dict(self.weights))


@dataclass(frozen=True)
class PointTree:
    """The points of a step, which of them are stages, and which are results.

    Attributes
    ----------
    points : tuple of Point
        Parents come before their children.
    stage_points : tuple of int
        The point that each stage is at; of explicit methods, the first stage is at `START`.
    result : int
        The point that the step leads to.
    embedded_result : int or None
        The second result of a pair.
    """

    points: tuple[Point, ...]
    stage_points: tuple[int, ...]
    result: int
    embedded_result: int | None = None

    @property
    def tree(self) -> PointTree:
        """The tree itself: a method has one too."""
        return self

    def path(self, point: int) -> tuple[int, ...]:
        """Return the points from the start to `point`, the start left out."""
        found: list[int] = []
        while point != START:
            found.append(point)
            point = self.points[point].parent
        return tuple(reversed(found))

    def flat_row(self, point: int) -> tuple[Fraction, ...]:
        """Return the sums of the weights on the path to a point, by stage: its flat tableau."""
        row = [Fraction(0)] * len(self.stage_points)
        for m in self.path(point):
            for stage, weight in self.points[m].weights.items():
                row[stage] += weight
        return tuple(row)

    @property
    def flat_tableau(self) -> tuple[tuple[tuple[Fraction, ...], ...], tuple[Fraction, ...]]:
        """The rows of the stages and the row of the result: ``(a, b)`` where flows commute."""
        return tuple(map(self.flat_row, self.stage_points)), self.flat_row(self.result)

    def flows(self, ends: Iterable[int]) -> int:
        """Return how many different flows lead to some points.

        Points with the same parent and weights count once, and those that have no weights
        only repeat their parents.
        """
        return len({self.merged[m] for end in ends for m in self.path(end)} - {START})

    @property
    def flow_between(self) -> Mapping[int, Fraction] | None:
        """The weights of the flow from the result to the second one; None if it isn't one flow."""
        if self.embedded_result is None:
            return None
        second = self.merged[self.embedded_result]
        if second == START or not self.same(self.points[second].parent, self.result):
            return None
        return self.points[second].weights

    def same(self, one: int, other: int) -> bool:
        """Tell whether the same flows lead to two points."""
        return self.merged[one] == self.merged[other]

    @cached_property
    def merged(self) -> dict[int, int]:
        """By each point, the first one that is the same, `START` among them."""
        first: dict[Point, int] = {}
        merged = {START: START}
        for m, point in enumerate(self.points):
            parent = merged[point.parent]
            same = Point(parent, point.weights)
            merged[m] = first.setdefault(same, m) if point.weights else parent
        return merged


def points_of(method: Any) -> PointTree:
    """Return the points of a method or of a tree of points; TypeError if it is anything else."""
    tree = getattr(method, "tree", None)
    if not isinstance(tree, PointTree):
        raise TypeError(f"method must be a Method or a PointTree, got {method!r}")
    return tree


def check_tree(tree: PointTree) -> None:
    """Refuse points that don't make an explicit method.

    Raises
    ------
    MethodError
        If a parent or a stage is no point, a parent comes after its child, the first stage
        isn't at the initial point, a weight is on a stage that isn't evaluated by then, or no
        stage influences a result.
    """
    _check_shape(tree)
    _check_sequence(tree)
    for label, end in (("result", tree.result), ("embedded_result", tree.embedded_result)):
        if end is None:
            continue
        _check_index(label, end, len(tree.points))
        if not any(tree.points[m].weights for m in tree.path(end)):
            raise MethodError(f"{label} must depend on a stage: no weights lead to point {end}")


def _check_shape(tree: PointTree) -> None:
    points, stages = len(tree.points), len(tree.stage_points)
    if stages == 0:
        raise MethodError("stage_points must have at least one entry, got none")
    for m, point in enumerate(tree.points):
        _check_index(f"the parent of point {m}", point.parent, points)
        if point.parent >= m:
            raise MethodError(
                f"the parent of point {m} must come before it, or there is a cycle, "
                f"got {point.parent}"
            )
        for stage in point.weights:
            if not _is_index(stage) or not 0 <= stage < stages:
                raise MethodError(
                    f"point {m} must have weights on stages 0 to {stages - 1}, got {stage!r}"
                )
    for stage, at in enumerate(tree.stage_points):
        _check_index(f"the point of stage {stage}", at, points)
    if tree.stage_points[0] != START:
        raise MethodError(
            f"the first stage must be at the initial point, {START}, got {tree.stage_points[0]}"
        )


def _check_sequence(tree: PointTree) -> None:
    """Refuse weights on stages that aren't evaluated by then, point by point or stage by stage."""
    for m, point in enumerate(tree.points):
        for stage in point.weights:
            if tree.stage_points[stage] >= m:
                raise MethodError(
                    f"point {m} has a weight on stage {stage}, which isn't evaluated by then: "
                    f"it is at point {tree.stage_points[stage]}"
                )
    for stage, at in enumerate(tree.stage_points):
        late = [k for m in tree.path(at) for k in tree.points[m].weights if k >= stage]
        if late:
            raise MethodError(
                f"stage {stage} is at point {at}, which depends on stage {late[0]}: "
                "that isn't evaluated by then"
            )


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _check_index(label: str, value: Any, points: int) -> None:
    if not _is_index(value) or not START <= value < points:
        raise MethodError(f"{label} must be a point from {START} to {points - 1}, got {value!r}")


def tree_of_rows(
    a: Sequence[Sequence[Fraction]],
    b: Sequence[Fraction],
    b_embedded: Sequence[Fraction] | None = None,
) -> PointTree:
    """Return the tree of a Crouch–Grossman tableau: each row is a chain of one weight a point.

    Rows that begin alike share their first points; a zero makes no point.

    Parameters
    ----------
    a : s rows of s numbers
        Strictly lower for an explicit method. Otherwise points have weights on stages that
        only equations determine.
    b, b_embedded : s numbers
    """
    index: dict[Point, int] = {}

    def chain(row: Iterable[Fraction]) -> int:
        last = START
        for stage, weight in enumerate(row):
            if weight != 0:
                last = index.setdefault(Point(last, {stage: weight}), len(index))
        return last

    stages = tuple(map(chain, a))
    result = chain(b)
    embedded = None if b_embedded is None else chain(b_embedded)
    return PointTree(tuple(index), stages, result, embedded)


def tree_of_flat_rows(a: Sequence[Sequence[Fraction]], b: Sequence[Fraction]) -> PointTree:
    """Return the tree of a Munthe-Kaas method: one flow from the start to each stage and result.

    Equal rows share a point; a row of zeros makes none.

    Parameters
    ----------
    a : s rows of s numbers
    b : s numbers
    """
    index: dict[tuple[Fraction, ...], int] = {}

    def point(row: Sequence[Fraction]) -> int:
        return index.setdefault(tuple(row), len(index)) if any(row) else START

    stages = tuple(map(point, a))
    result = point(b)
    return PointTree(tuple(Point(START, dict(enumerate(row))) for row in index), stages, result)
