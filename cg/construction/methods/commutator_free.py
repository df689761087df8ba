"""Commutator-free methods: flows of linear combinations of frozen fields."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from cg.construction.layouts.layout import Layout
from cg.construction.layouts.points import MethodError, Point, PointTree, check_tree
from cg.construction.methods.coefficients import (
    Coefficient,
    read_coefficient,
    read_sequence,
    read_texts,
    read_third,
    values_of,
)
from cg.construction.methods.flat import flat_order
from cg.construction.methods.method import Method
from cg.construction.methods.tableau import Tableau
from cg.support import quads


@dataclass(frozen=True, init=False, eq=False, repr=False)
class CommutatorFree(Method):
    r"""An explicit commutator-free method [1]_.

    The flow of ``Σ_k α_mk F_k`` leads from an earlier point to point m of a step, where F_k is
    the field frozen at stage k, and each stage is at one of the earlier points. Crouch–Grossman
    methods have one weight per point. Two methods are equal if all their points and coefficients
    are equal.

    Parameters
    ----------
    points
        Sequence of pairs. The parent of each point, an index or -1 for the initial point, and a
        mapping from stages (from 0) to weights, or a `Point`. Weights are strings, Fractions,
        integers or floats; see `Coefficient.read`.
    stage_points
        Sequence of int. The point at which each stage is evaluated; the first is -1.
    result
        The point that the step leads to, by default the last.
    embedded_result
        The point of the second result of a pair. The flows to it should differ from those to the
        result: errors that both results have in common aren't seen.
    third
        Sequence of s numbers. Third weights of a pair, of lower order than the second: those of one
        flow from the initial point to a third result. If the second result is :math:`e` from the
        first, and the third :math:`e_3`, the estimate is :math:`|e|^2 / \sqrt{|e|^2 + 0.01
        |e_3|^2}` as in DOP853 [2]_: the larger one of that of the quadratures, where flows commute,
        and that of the rest.
    name, source
        Name and origin of the method.
    nominal_order, nominal_residual
        As for `cg.Tableau`.

    Raises
    ------
    MethodError
        If a parent or a stage isn't a point, a parent comes after its child, the first stage
        isn't at the initial point, a weight is on a stage that is evaluated later, a result
        depends on no stage, both results are the same, a number isn't finite, or residuals
        exceed `nominal_residual`; if third weights have a wrong length, or there is no second
        result.

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
        values = read_texts(name, source, nominal_order, nominal_residual)
        read = [
            _read_point(point, m) for m, point in enumerate(read_sequence(points, "points", of=""))
        ]
        if not read:
            raise MethodError("points must have at least one entry, got none")
        tree = PointTree(
            tuple(Point(parent, {k: w.value for k, w in row.items()}) for parent, row in read),
            tuple(map(as_index, read_sequence(stage_points, "stage_points", of=""))),
            len(read) - 1 if result is None else as_index(result),
            as_index(embedded_result),
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
        values["third_weights"] = read_third(third, len(tree.stage_points), tree.embedded_result)
        self._set(values)
        self._check_nominal_order()

    @classmethod
    def from_layout(
        cls, layout: Layout, coefficients: Sequence[Any], **fields: Any
    ) -> CommutatorFree:
        """Return the method with a layout and packed weights, point by point."""
        return cls(
            zip(layout.parents, layout.point_weights(coefficients), strict=True),
            layout.stage_points,
            layout.results[0],
            embedded_result=layout.results[1] if layout.pair else None,
            **fields,
        )

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.tree, values_of(self.third_weights)

    @cached_property
    def layout(self) -> Layout:
        return Layout.of_tree(self.tree)

    @property
    def point_coefficients(self) -> tuple[dict[int, Coefficient], ...]:
        """The coefficients of each point, by stage."""
        return tuple(self.layout.point_weights(self.coefficients))

    @cached_property
    def embedded(self) -> CommutatorFree | None:
        if self.tree.embedded_result is None:
            return None
        parents = (point.parent for point in self.tree.points)
        return CommutatorFree(
            zip(parents, self.point_coefficients, strict=True),
            self.tree.stage_points,
            self.tree.embedded_result,
            **self._embedded_names,
        )

    @cached_property
    def error_weights(self) -> tuple[tuple[Fraction, ...], ...]:
        """Differences of quadratures of the result that advances from two others.

        They are those of results where flows commute. Empty without third weights.
        """
        if self.third_weights is None or self.tree.embedded_result is None:
            return ()
        sums, other = map(self.tree.flat_row, self.advancing_results)
        others = other, [w.value for w in self.third_weights]
        return tuple(tuple(b - w for b, w in zip(sums, row, strict=True)) for row in others)

    @property
    def third_flow(self) -> tuple[Coefficient, ...] | None:
        return self.third_weights

    @cached_property
    def third_order(self) -> int | None:
        """Order of the third weights for commuting flows; None without them."""
        if self.third_weights is None:
            return None
        # rows of the flat tableau are sums of rounded weights, and rounded as well
        rows = [[quads.to_decimal(entry) for entry in row] for row in self.exact[0]]
        return flat_order(Tableau(rows, self.third_weights))


def as_index(index: Any) -> Any:
    """Return a NumPy integer as an int, and other values unchanged; `check_tree` refuses those."""
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
    return as_index(parent), {
        as_index(stage): read_coefficient(weight, f"weight of point {m} on stage {stage}")
        for stage, weight in weights.items()
    }
