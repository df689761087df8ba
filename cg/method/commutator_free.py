"""Commutator-free methods: several frozen fields a flow, and flows from any earlier point."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from ..structure.layout import Layout
from ..structure.points import MethodError, Point, PointTree, check_tree
from ..support import quads
from .coefficients import Coefficient
from .flat import flat_order
from .method import Method, read_coefficient, read_texts
from .tableau import Tableau

__all__ = ["CommutatorFree"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class CommutatorFree(Method):
    r"""An explicit method whose flows are those of combinations of frozen fields [1]_.

    Point m of a step is reached by the flow of ``Σ_k α_mk F_k`` from an earlier point, where
    F_k is the field frozen at stage k, which is one of the points before. Methods of
    Crouch–Grossman type have one weight a point. Two methods are equal if all their points
    and coefficients are.

    Parameters
    ----------
    points : sequence of pairs
        The parent of each point, an index or -1 for the initial point, and a mapping from
        stages (from 0) to weights; `Point` records serve too. Weights as `Coefficient.read`
        takes them: strings, Fractions, integers, floats.
    stage_points : sequence of int
        The point that each stage is at; the first is -1.
    result : int, optional
        The point that the step leads to, by default the last.
    embedded_result : int, optional
        A second result that makes the method a pair. If it is one flow from the result, the error
        is estimated by the combination of frozen fields that this flow is along, and takes none.
    third : sequence of s numbers, optional
        Third weights of such a pair, of lower order than the second: the estimate then is
        :math:`|e|^2 / \sqrt{|e|^2 + 0.01 |e_3|^2}`, with :math:`e_3` the combination of frozen
        fields with the sums of weights that lead to the result less these, as DOP853 has it [2]_.
    name, source : str, optional
        What the method is called and where it is from.
    nominal_order, nominal_residual : optional
        As for `cg.Tableau`.

    Raises
    ------
    MethodError
        If a parent or a stage is no point, a parent comes after its child, the first stage
        isn't at the initial point, a weight is on a stage that isn't evaluated by then, no
        stage influences a result, both results are the same, a number isn't finite, a nominal
        order isn't borne out, or third weights have a wrong length or belong to no pair whose
        second result is one flow from the first.

    References
    ----------
    .. [1] E. Celledoni, A. Marthinsen, B. Owren, "Commutator-free Lie group methods", Future
       Generation Computer Systems 19 (2003), 341-352.
    .. [2] E. Hairer, S. P. Nørsett, G. Wanner, "Solving Ordinary Differential Equations I", 2nd
       ed., Springer, 1993, section II.5.

    Examples
    --------
    >>> points = [(-1, {0: "1/3"}), (-1, {1: "2/3"}), (0, {0: "-1/12", 2: "3/4"})]
    >>> method = CommutatorFree(points, [-1, 0, 1], name="CF3")
    >>> method.order, method.stages, method.exponentials
    (3, 3, 3)
    """

    name: str
    source: str
    tree: PointTree
    coefficients: tuple[Coefficient, ...]
    third_weights: tuple[Coefficient, ...] | None
    nominal_order: int | None
    nominal_residual: Coefficient | None

    def __init__(
        self,
        points: Iterable[Any],
        stage_points: Iterable[int],
        result: int | None = None,
        *,
        embedded_result: int | None = None,
        third: Iterable[Any] | None = None,
        name: str = "",
        source: str = "",
        nominal_order: int | None = None,
        nominal_residual: Any = None,
    ) -> None:
        values = read_texts(name, source, (nominal_order, nominal_residual))
        read = [_read_point(point, m) for m, point in enumerate(_listed(points, "points"))]
        if not read:
            raise MethodError("points must have at least one entry, got none")
        tree = PointTree(
            tuple(Point(parent, {k: w.value for k, w in row.items()}) for parent, row in read),
            tuple(map(_plain, _listed(stage_points, "stage_points"))),
            len(read) - 1 if result is None else _plain(result),
            _plain(embedded_result),
        )
        check_tree(tree)
        if tree.embedded_result is not None and tree.same(tree.result, tree.embedded_result):
            raise MethodError("embedded_result must differ from result, or it estimates no error")
        values["tree"] = tree
        values["coefficients"] = tuple(
            row[stage]
            for point, (_, row) in zip(tree.points, read, strict=True)
            for stage in point.weights
        )
        values["third_weights"] = None if third is None else _read_third(third, tree)
        for field, value in values.items():
            object.__setattr__(self, field, value)
        if self.nominal_order is not None:
            self._check_nominal_order(MethodError)

    @classmethod
    def from_layout(
        cls, layout: Layout, coefficients: Sequence[Any], **names: Any
    ) -> CommutatorFree:
        """Return the method with these weights, point after point."""
        return cls(
            zip(layout.parents, layout.point_weights(coefficients), strict=True),
            layout.stage_points,
            layout.results[0],
            embedded_result=layout.results[1] if layout.pair else None,
            **names,
        )

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what was derived: arrays would come back writeable."""
        return {field.name: self.__dict__[field.name] for field in fields(self)}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, CommutatorFree):
            return NotImplemented
        return (self.tree, self.third_weights) == (other.tree, other.third_weights)

    def __hash__(self) -> int:
        return hash((self.tree, self.third_weights))

    @cached_property
    def layout(self) -> Layout:
        """Where each coefficient stands in `coefficients`."""
        return Layout.of_tree(self.tree)

    @property
    def point_coefficients(self) -> tuple[dict[int, Coefficient], ...]:
        """The weights of each point with their text, by stage."""
        return tuple(self.layout.point_weights(self.coefficients))

    @cached_property
    def embedded(self) -> CommutatorFree | None:
        """The method that leads to the second result of a pair; None without it."""
        if self.tree.embedded_result is None:
            return None
        parents = (point.parent for point in self.tree.points)
        return CommutatorFree(
            zip(parents, self.point_coefficients, strict=True),
            self.tree.stage_points,
            self.tree.embedded_result,
            name=f"{self.name}, embedded" if self.name else "",
            source=self.source,
        )

    @cached_property
    def error_weights(self) -> tuple[tuple[Fraction, ...], ...]:
        """Weights on frozen fields of the error estimates, if these take no flow; else empty."""
        flow = self.tree.flow_between
        if flow is None:
            return ()
        rows = [tuple(-flow.get(k, Fraction(0)) for k in range(self.stages))]
        if self.third_weights is not None:
            sums = self.tree.flat_row(self.tree.result)
            rows.append(tuple(b - w.value for b, w in zip(sums, self.third_weights, strict=True)))
        return tuple(rows)

    @cached_property
    def third_order(self) -> int | None:
        """Order of the third weights where flows commute; None without."""
        if self.third_weights is None:
            return None
        # Sums of weights that are rounded are right to their last place.
        rows = [[quads.to_decimal(entry) for entry in row] for row in self.exact[0]]
        return flat_order(Tableau(rows, self.third_weights))


def _read_third(third: Iterable[Any], tree: PointTree) -> tuple[Coefficient, ...]:
    """Return third weights; MethodError if they aren't as many numbers, or have no place."""
    if tree.flow_between is None:
        raise MethodError("third must be None unless embedded_result is one flow from the result")
    entries = _listed(third, "third")
    if len(entries) != len(tree.stage_points):
        raise MethodError(f"third must have {len(tree.stage_points)} entries, got {len(entries)}")
    return tuple(read_coefficient(entry, f"third_{k}") for k, entry in enumerate(entries, 1))


def _listed(value: Any, label: str) -> list[Any]:
    if isinstance(value, str | bytes | Mapping | set | frozenset):
        raise MethodError(f"{label} must be a sequence, got {value!r}")
    try:
        return list(value)
    except TypeError:
        raise MethodError(f"{label} must be a sequence, got {value!r}") from None


def _plain(index: Any) -> Any:
    """Return an integer of NumPy as Python's; what is none is refused later."""
    return int(index) if isinstance(index, np.integer) else index


def _read_point(point: Any, m: int) -> tuple[int, dict[int, Coefficient]]:
    if isinstance(point, Point):
        point = point.parent, point.weights
    try:
        parent, weights = point
        if not isinstance(weights, Mapping):
            raise TypeError
    except (TypeError, ValueError):
        raise MethodError(
            f"point {m} must be a parent and a mapping from stages to weights, got {point!r}"
        ) from None
    return _plain(parent), {
        _plain(stage): read_coefficient(weight, f"weight of point {m} on stage {stage}")
        for stage, weight in weights.items()
    }
