"""Layouts, positions of weights in a packed vector, and trees of points, the flows of a step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from fractions import Fraction
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cg.support.checks import check_integer

START = -1
"""Index of the initial point of a step."""

T = TypeVar("T")


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
                if stage < len(row):  # those after them are on brackets of linear equations
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
    a: Sequence[Sequence[Fraction]],
    b: Sequence[Fraction],
    b_embedded: Sequence[Fraction] | None = None,
    *,
    flat: bool = False,
) -> PointTree:
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


class Rows(IntEnum):
    """Which entries of ``a`` a tableau may have.

    >>> [rows.name for rows in Rows]
    ['EXPLICIT', 'DIAGONAL', 'FULL']
    """

    EXPLICIT = 0
    DIAGONAL = 1
    FULL = 2


def check_rows(rows: Rows | str | int) -> Rows:
    """Return the pattern with a name or a number; ValueError if there is none.

    >>> check_rows("diagonal")
    <Rows.DIAGONAL: 1>
    """
    if isinstance(rows, Rows):
        return rows
    names = {pattern.name.lower(): pattern for pattern in Rows}
    if isinstance(rows, str) and rows in names:
        return names[rows]
    if isinstance(rows, int | np.integer) and not isinstance(rows, bool) and rows in tuple(Rows):
        return Rows(rows)
    raise ValueError(f"rows must be one of {', '.join(names)}, got {rows!r}")


def unknowns(stages: int, rows: Rows | str | int = Rows.EXPLICIT) -> int:
    """Return the number of entries of a tableau: s(s + 1)/2 for explicit ones.

    >>> [unknowns(4, rows) for rows in Rows]
    [10, 14, 20]
    """
    s = check_integer("stages", stages, 1)
    above = {Rows.EXPLICIT: s * (s - 1) // 2, Rows.DIAGONAL: s * (s + 1) // 2, Rows.FULL: s * s}
    return above[check_rows(rows)] + s


def rows_of(a: Sequence[Sequence[Any]] | NDArray[Any]) -> Rows:
    """Return the narrowest pattern that holds all nonzero entries of ``a``."""
    reach = max(
        (j - i for i, row in enumerate(a) for j, entry in enumerate(row) if entry != 0), default=-1
    )
    return Rows.EXPLICIT if reach < 0 else Rows.DIAGONAL if reach == 0 else Rows.FULL


@dataclass(frozen=True)
class Layout:
    """A method without its numbers: its flows, and the stages whose fields each flow combines.

    The unknowns are the weights, packed point by point. In the layout of a tableau each entry, also
    a zero, is a point of its own: the rows of ``a``, then ``b``, then the second weights of a pair.
    """

    parents: tuple[int, ...]  # parent of each point; `START` for the initial point
    weights: tuple[tuple[int, ...], ...]  # increasing stages, from 0, of each point's weights
    stage_points: tuple[int, ...]
    results: tuple[int, ...]  # point of the result, and of the second result of a pair
    rows: Rows | None = None  # pattern of a tableau, None for other methods
    of_time: bool = False  # for linear equations: a stage's weight is its node

    @classmethod
    def tableau(
        cls, stages: int, rows: Rows | str | int = Rows.EXPLICIT, pair: bool = False
    ) -> Layout:
        """Return the layout of a Crouch–Grossman tableau; a pair has two rows of weights."""
        return _tableau(check_integer("stages", stages, 1), check_rows(rows), bool(pair))

    @classmethod
    def of_tree(cls, tree: PointTree) -> Layout:
        """Return the layout of the nonzero weights of a tree of points."""
        return cls(
            tuple(point.parent for point in tree.points),
            tuple(tuple(point.weights) for point in tree.points),
            tree.stage_points,
            tree.results,
        )

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.stage_points)

    @property
    def pair(self) -> bool:
        """Whether there is a second result."""
        return len(self.results) > 1

    @property
    def flows(self) -> int:
        """Number of flows, without one to a second result."""
        return len(self.parents) - self.pair

    @cached_property
    def size(self) -> int:
        """Number of unknowns."""
        return sum(map(len, self.weights))

    @cached_property
    def stage_of(self) -> NDArray[np.intp]:
        """The stage (from 0) of each unknown; shape (size,)."""
        return np.array([stage for weights in self.weights for stage in weights], dtype=np.intp)

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """Index of the first unknown of each point, then `size`."""
        return tuple(np.cumsum([0, *map(len, self.weights)]).tolist())

    @property
    def ends(self) -> tuple[int, ...]:
        """The points of the stages, then those of the results: the end of each row of a tableau."""
        return *self.stage_points, *self.results

    @property
    def _tableau_rows(self) -> Rows:
        if self.rows is None:
            raise ValueError("layout must be that of a tableau, got one of points")
        return self.rows

    def path(self, point: int) -> list[int]:
        """Return the points from the initial point to `point`, without the initial point."""
        path: list[int] = []
        while point != START:
            path.append(point)
            point = self.parents[point]
        return path[::-1]

    def row(self, r: int) -> list[int]:
        """Return the unknowns on the path of row r: of a stage (from 0), or of a result."""
        return [
            k for m in self.path(self.ends[r]) for k in range(self.starts[m], self.starts[m + 1])
        ]

    @property
    def names(self) -> list[str]:
        """Names of the unknowns, with points and stages counted from 1.

        Those of a tableau are ``a_3,1``, ``b_2`` and ``b_embedded_2``, other weights ``w_3,1`` for
        point 3 and stage 1, nodes ``c_2``.
        """
        if self.rows is None:
            nodes = sum(point != START for point in self.stage_points) if self.of_time else 0
            return [
                f"c_{stage + 1}" if m < nodes else f"w_{m - nodes + 1},{stage + 1}"
                for m, weights in enumerate(self.weights)
                for stage in weights
            ]
        labels = [f"a_{r}," for r in range(1, self.stages + 1)] + ["b_", "b_embedded_"]
        return [
            f"{label}{self.stage_of[k] + 1}"
            for r, label in enumerate(labels[: len(self.ends)])
            for k in self.row(r)
        ]

    @property
    def fixed(self) -> list[int]:
        """The unknowns that are fixed at zero: the second weight of the last stage of a pair.

        With equal weights of this stage the error estimate would not depend on it.
        """
        if self.rows is None or not self.pair:
            return []
        return [self.row(self.stages + 1)[-1]]

    def column(self, stage: int) -> NDArray[np.intp]:
        """Return the weights of a stage (from 0) in other stages and in results."""
        row = self.row(stage)
        return np.setdiff1d(np.flatnonzero(self.stage_of == stage), row)

    def without(self, stage: int) -> tuple[Layout, list[int]]:
        """Return the layout of a tableau without a stage (from 0), and the remaining unknowns."""
        rows = self._tableau_rows
        dropped = {*self.row(stage), *np.flatnonzero(self.stage_of == stage).tolist()}
        kept = [k for k in range(self.size) if k not in dropped]
        return Layout.tableau(self.stages - 1, rows, self.pair), kept

    def cut(self, x: Sequence[T] | NDArray[Any]) -> list[list[T]]:
        """Return the packed unknowns of a tableau row by row."""
        _ = self._tableau_rows
        check_length(x, self.size)
        return [[x[k] for k in self.row(r)] for r in range(len(self.ends))]

    def full_rows(self, x: Sequence[T] | NDArray[Any]) -> list[list[T | int]]:
        """Return the rows of `cut`, padded with zeros to the number of stages."""
        return [[*row, *[0] * (self.stages - len(row))] for row in self.cut(x)]

    def packed(self, rows: Sequence[Sequence[T]]) -> list[T]:
        """Return the packed unknowns of full rows: those of ``a``, ``b`` and the second weights."""
        lengths = _row_lengths(self.stages, self._tableau_rows, self.pair)
        return [entry for row, length in zip(rows, lengths, strict=True) for entry in row[:length]]

    def point_weights(self, x: Sequence[T]) -> list[dict[int, T]]:
        """Return the weights of each point as a mapping from stages."""
        return [
            {stage: x[begin + k] for k, stage in enumerate(weights)}
            for begin, weights in zip(self.starts, self.weights, strict=False)
        ]

    def tree(self, x: Sequence[Fraction]) -> PointTree:
        """Return the tree of points with packed weights; zeros of a tableau make no points."""
        if self.rows is not None:
            rows: list[Any] = self.full_rows(x)
            return tree_of_rows(rows[: self.stages], *rows[self.stages :])
        points = map(Point, self.parents, self.point_weights(x))
        return PointTree(tuple(points), self.stage_points, *self.results)

    @cached_property
    def segments(self) -> int:
        """Upper bound of the number of chains of points with no branch, stage or result inside."""
        after = {m - 1 for m, parent in enumerate(self.parents) if parent != m - 1}
        branches = {parent for m, parent in enumerate(self.parents) if parent != m - 1}
        return len(({*self.ends, len(self.parents) - 1} | after | branches) - {START})

    def check_places(self) -> None:
        """Raise MethodError if a point or stage is named that there isn't, or a later parent."""
        points, used = len(self.parents), self.stage_of.tolist()
        late = any(not START <= parent < m for m, parent in enumerate(self.parents))
        beyond = any(not START <= at < points for at in self.ends)
        if late or beyond or points != len(self.weights) or set(used) - set(range(self.stages)):
            raise MethodError(
                f"points must lead from earlier ones along fields of stages 0 to {self.stages - 1},"
                f" and stages and results be among them, got {self!r}"
            )

    @cached_property
    def code(self) -> NDArray[np.intc]:
        """The layout as integers for the compiled core; see ``read_layout`` there."""
        self.check_places()
        second = self.results[1] + 1 if self.pair else 0
        numbers = [
            self.stages,
            len(self.parents),
            self.results[0] + 1,
            second,
            *(at + 1 for at in self.stage_points),
            *(parent + 1 for parent in self.parents),
            *map(len, self.weights),
            *(stage + 1 for stage in self.stage_of.tolist()),
        ]
        code = np.array(numbers, dtype=np.intc)
        code.flags.writeable = False
        return code


@lru_cache(maxsize=64)
def _tableau(stages: int, rows: Rows, pair: bool) -> Layout:
    parents: list[int] = []
    columns: list[tuple[int, ...]] = []
    ends = []
    for length in _row_lengths(stages, rows, pair):
        last = START
        for stage in range(length):
            parents.append(last)
            columns.append((stage,))
            last = len(parents) - 1
        ends.append(last)
    return Layout(tuple(parents), tuple(columns), tuple(ends[:stages]), tuple(ends[stages:]), rows)


def check_length(x: Any, size: int, name: str = "x") -> None:
    """Raise ValueError unless `x` is a sequence of length `size`."""
    other = isinstance(x, str | bytes) or not isinstance(x, Sequence | np.ndarray)
    if other or (isinstance(x, np.ndarray) and x.ndim != 1):
        raise ValueError(f"{name} must be a sequence of numbers, got {x!r}")
    if len(x) != size:
        raise ValueError(f"{name} must have {size} entries, got {len(x)}")


def _row_lengths(stages: int, rows: Rows, pair: bool) -> tuple[int, ...]:
    lengths = {
        Rows.EXPLICIT: range(stages),
        Rows.DIAGONAL: range(1, stages + 1),
        Rows.FULL: (stages,) * stages,
    }[rows]
    return (*lengths, *(1 + pair) * (stages,))
