"""Trees of points: the flows of a step, and which of them lead to its stages and results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

START = -1
"""Index of the initial point of a step."""


class MethodError(ValueError):
    """Raised if points or coefficients don't make a method; the message names the wrong one.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> try:
    ...     cg.CommutatorFree([(0, {0: 1})], [-1], 0)
    ... except cg.MethodError as error:
    ...     print(error)
    the parent of point 0 must come before it, or there is a cycle, got 0
    """


@dataclass(frozen=True, eq=False)
class Point:
    r"""A point of a step, reached from an earlier point `parent`, or `START`, by one flow.

    .. math:: y_m = \exp\Bigl(h \sum_k \alpha_{m,k} F_k\Bigr) y_{\mathrm{parent}(m)}

    `weights` are the nonzero α by the stages (from 0) whose frozen fields they multiply.
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
    """The points of a step, parents before children, with the points of its stages and results."""

    points: tuple[Point, ...]
    stage_points: tuple[int, ...]
    result: int
    embedded_result: int | None = None

    @property
    def tree(self) -> PointTree:
        """The tree itself, so that methods and trees have the same interface."""
        return self

    @property
    def results(self) -> tuple[int, ...]:
        """The points of the result, and of the second result if there is one."""
        second = () if self.embedded_result is None else (self.embedded_result,)
        return self.result, *second

    def path(self, point: int) -> tuple[int, ...]:
        """Return the points from the initial point to `point`, without the initial point."""
        path: list[int] = []
        while point != START:
            path.append(point)
            point = self.points[point].parent
        return tuple(reversed(path))

    def flat_row(self, point: int) -> tuple[Fraction, ...]:
        """Return the sums of the weights on the path to a point, by stage."""
        row = [Fraction(0)] * len(self.stage_points)
        for m in self.path(point):
            for stage, weight in self.points[m].weights.items():
                if stage < len(row):  # further weights are on brackets of linear equations
                    row[stage] += weight
        return tuple(row)

    def flows(self, ends: Iterable[int]) -> int:
        """Return the number of different flows, those with weights, on the paths to points."""
        return len({self.merged[m] for end in ends for m in self.path(end)} - {START})

    def roles(self) -> dict[int, list[str]]:
        """Return the roles of each point, such as ``{-1: ["stage 1"], 0: ["result"]}``."""
        roles: dict[int, list[str]] = {}
        for stage, point in enumerate(self.stage_points, 1):
            roles.setdefault(point, []).append(f"stage {stage}")
        roles.setdefault(self.result, []).append("result")
        if self.embedded_result is not None:
            roles.setdefault(self.embedded_result, []).append("second result")
        return roles

    @cached_property
    def merged(self) -> dict[int, int]:
        """The first point with the same path, for each point and `START`."""
        first: dict[Point, int] = {}
        merged = {START: START}
        for m, point in enumerate(self.points):
            parent = merged[point.parent]
            same = Point(parent, point.weights)
            merged[m] = first.setdefault(same, m) if point.weights else parent
        return merged

    def without_repetitions(self) -> PointTree:
        """Return the tree in which paths, and stages and results, have one of equal points."""
        same = self.merged
        points = tuple(Point(same[point.parent], point.weights) for point in self.points)
        stages = tuple(same[at] for at in self.stage_points)
        return PointTree(points, stages, *(same[end] for end in self.results))


class FlatSums(np.ndarray[Any, np.dtype[np.float64]]):
    """Sums of the weights of several flows, which the arrays of a method are views of."""


def check_not_sums(a: Any) -> None:
    """Raise ValueError if rows are those that a method has if flows commute."""
    while isinstance(a, np.ndarray):
        if isinstance(a, FlatSums):
            raise ValueError(
                "a must be the rows of a Crouch-Grossman tableau, got sums of the weights of "
                "several flows, which don't determine a method: "
                "cg.conditions.residuals(method, order) takes it"
            )
        a = a.base


def points_of(method: Any) -> PointTree:
    """Return the tree of a method or of a tree itself; TypeError for other objects."""
    tree = getattr(method, "tree", None)
    if not isinstance(tree, PointTree):
        raise TypeError(f"method must be a Method or a PointTree, got {method!r}")
    return tree


def check_tree(tree: PointTree) -> None:
    """Raise MethodError unless points make an explicit method."""
    points, stages = tree.points, tree.stage_points
    results = dict(zip(("result", "embedded_result"), tree.results, strict=False))
    if not stages:
        raise MethodError("stage_points must have at least one entry, got none")
    places = {f"the parent of point {m}": point.parent for m, point in enumerate(points)}
    places |= {f"the point of stage {stage}": at for stage, at in enumerate(stages)}
    for label, value in (places | results).items():
        if not _is_index(value) or not START <= value < len(points):
            raise MethodError(
                f"{label} must be a point from {START} to {len(points) - 1}, got {value!r}"
            )
    if stages[0] != START:
        raise MethodError(f"the first stage must be at the initial point, {START}, got {stages[0]}")
    for m, point in enumerate(points):
        if point.parent >= m:
            raise MethodError(
                f"the parent of point {m} must come before it, or there is a cycle, "
                f"got {point.parent}"
            )
        for stage in point.weights:
            if not _is_index(stage) or not 0 <= stage < len(stages) or stages[stage] >= m:
                raise MethodError(
                    f"point {m} must have weights on earlier stages, of 0 to {len(stages) - 1}, "
                    f"got one on stage {stage!r}"
                )
    for stage, at in enumerate(stages):  # the sequence of stages may be another one
        late = [k for m in tree.path(at) for k in points[m].weights if k >= stage]
        if late:
            raise MethodError(
                f"stage {stage} must depend on earlier stages, but its point {at} depends on "
                f"stage {late[0]}"
            )
    for label, end in results.items():
        if not any(points[m].weights for m in tree.path(end)):
            raise MethodError(f"{label} must depend on a stage: no weights lead to point {end}")


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def tree_of_rows(
    a: Sequence[Sequence[Fraction]], b: Sequence[Fraction],
    b_embedded: Sequence[Fraction] | None = None, *, flat: bool = False,
) -> PointTree:  # fmt: skip
    """Return the tree of a Crouch–Grossman tableau: each nonzero entry of a row is a point.

    Rows with equal first entries share the points of these. With `flat` it is that of a Munthe-Kaas
    method: one flow from the start to each stage and result.
    """
    index: dict[Point, int] = {}

    def chain(row: Sequence[Fraction]) -> int:
        last = START
        entries = dict(enumerate(row))
        for weights in [entries] if flat else [{stage: entries[stage]} for stage in entries]:
            if any(weights.values()):
                last = index.setdefault(Point(last, weights), len(index))
        return last

    stages = tuple(map(chain, a))
    result = chain(b)
    embedded = None if b_embedded is None else chain(b_embedded)
    return PointTree(tuple(index), stages, result, embedded)
