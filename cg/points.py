"""Trees of points: what an explicit method does on a manifold, flow by flow."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from types import MappingProxyType

__all__ = ["START", "Point", "PointTree", "tree_of_rows"]

START = -1
"""The index of the point that a step starts from."""


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
        The point that each stage is at; the first stage is at `START`.
    result : int
        The point that the step leads to.
    embedded_result : int or None
        The second result of a pair.
    """

    points: tuple[Point, ...]
    stage_points: tuple[int, ...]
    result: int
    embedded_result: int | None = None

    def path(self, point: int) -> tuple[int, ...]:
        """Return the points from the start to `point`, the start left out."""
        found: list[int] = []
        while point != START:
            found.append(point)
            point = self.points[point].parent
        return tuple(reversed(found))


def tree_of_rows(
    a: Sequence[Sequence[Fraction]],
    b: Sequence[Fraction],
    b_embedded: Sequence[Fraction] | None = None,
) -> PointTree:
    """Return the tree of a Crouch–Grossman tableau: each row is a chain of one weight a point.

    Rows that begin alike share their first points; a zero makes no point.

    Parameters
    ----------
    a : s rows of s numbers, strictly lower
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
