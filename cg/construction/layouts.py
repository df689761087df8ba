"""Layouts: the positions of the weights of a method in a packed vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import accumulate, chain, pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cg.construction.points import START, MethodError, Point, PointTree, tree_of_rows
from cg.support.arrays import read_only
from cg.support.checks import check_integer

T = TypeVar("T")

MAX_STAGES = 1000
"""Largest number of stages s; matrices of solvers have s (s + 1) / 2 columns and must fit into
memory."""


class Rows(IntEnum):
    """The entries of ``a`` that a tableau may have.

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
        """The points of the stages, then of the results: the end of each row of a tableau."""
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

        Names of a tableau are ``a_3,1``, ``b_2`` and ``b_embedded_2``, other weights ``w_3,1`` for
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
        return [self.row(self.stages + 1)[-1]] if self.rows is not None and self.pair else []

    def column(self, stage: int) -> NDArray[np.intp]:
        """Return the weights of a stage (from 0) in other stages and in results."""
        return np.setdiff1d(np.flatnonzero(self.stage_of == stage), self.row(stage))

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
        branches = [(m - 1, at) for m, at in enumerate(self.parents) if at != m - 1]
        return len({*self.ends, len(self.parents) - 1, *chain(*branches)} - {START})

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
        return read_only(np.array(numbers, dtype=np.intc))


@lru_cache(maxsize=64)
def _tableau(stages: int, rows: Rows, pair: bool) -> Layout:
    lengths = _row_lengths(stages, rows, pair)
    points = [range(*ends) for ends in pairwise(accumulate(lengths, initial=0))]
    parents = tuple(m - 1 if m > row.start else START for row in points for m in row)
    weights = tuple((stage,) for length in lengths for stage in range(length))
    ends = tuple(row[-1] if row else START for row in points)
    return Layout(parents, weights, ends[:stages], ends[stages:], rows)


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
