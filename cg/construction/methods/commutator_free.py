"""Commutator-free methods and Munthe-Kaas methods.

The flows of commutator-free methods are those of combinations of frozen fields; Munthe-Kaas methods
have a classical tableau for the coordinates of a step.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from cg.construction.layouts import Layout
from cg.construction.methods.classical_conditions import flat_order, flat_residuals
from cg.construction.methods.coefficients import (
    Coefficient,
    read_coefficient,
    read_sequence,
    read_texts,
    read_third,
    values_of,
)
from cg.construction.methods.method import Method
from cg.construction.methods.tableau import Tableau
from cg.construction.points import MethodError, Point, PointTree, check_tree, tree_of_rows
from cg.support import quads
from cg.support.checks import check_flag, check_integer

_QUADRATURE_ROUNDING = 1e-14  # error of integrals by a collocation method


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
        self, points: Iterable[Any], stage_points: Iterable[int], result: int | None = None, *,
        embedded_result: int | None = None, third: Iterable[Any] | None = None, name: str = "",
        source: str = "", nominal_order: int | None = None, nominal_residual: Any = None,
    ) -> None:  # fmt: skip
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
        if len({tree.merged[end] for end in tree.results}) < len(tree.results):
            raise MethodError("embedded_result must differ from result, or it estimates no error")
        values["tree"] = tree
        values["coefficients"] = tuple(
            row[stage]
            for point, (_, row) in zip(tree.points, read, strict=True)
            for stage in point.weights
        )
        values["third_weights"] = read_third(third, len(tree.stage_points), tree.embedded_result)
        vars(self).update(values)
        self._check_nominal_order()

    @classmethod
    def from_layout(
        cls, layout: Layout, coefficients: Sequence[Any], **fields: Any
    ) -> CommutatorFree:
        """Return the method with a layout and packed weights, point by point.

        `fields` are further keyword arguments of the class, such as `name` and `source`.
        """
        return cls(
            zip(layout.parents, layout.point_weights(coefficients), strict=True),
            layout.stage_points,
            layout.results[0],
            embedded_result=layout.results[1] if layout.pair else None,
            **fields,
        )

    def _with(self, coefficients: Sequence[Any], **fields: Any) -> CommutatorFree:
        return CommutatorFree.from_layout(self.layout, coefficients, **fields)

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
        layout = replace(self.layout, results=(self.tree.embedded_result,))
        return CommutatorFree.from_layout(layout, self.coefficients, **self._embedded_names)

    @cached_property
    def error_weights(self) -> tuple[tuple[Fraction, ...], ...]:
        """Differences of quadratures of the result that advances from two others.

        They are those of results where flows commute. Empty without third weights.
        """
        if self.third_weights is None or self.tree.embedded_result is None:
            return ()
        sums, other = map(self.tree.flat_row, self.advancing_results)
        other_results = other, values_of(self.third_weights)
        return tuple(tuple(b - w for b, w in zip(sums, row, strict=True)) for row in other_results)

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
    """Return a NumPy integer as an int, and other values unchanged, which `check_tree` refuses."""
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


@dataclass(frozen=True, init=False, eq=False, repr=False)
class MuntheKaas(Method):
    r"""A Runge–Kutta–Munthe-Kaas method: a classical tableau on a Lie algebra.

    A step applies the tableau to the differential equation of the coordinates σ of the point,
    :math:`y = \exp(\sigma)\, y_0`, which is an equation in a vector space [1]_:

    .. math::

        \sigma_i = h \sum_j a_{ij} k_j, \qquad
        k_i = \operatorname{dexp}^{-1}_{\sigma_i} f(t_0 + c_i h, \exp(\sigma_i)\, y_0), \qquad
        y_1 = \exp\Bigl(h \sum_i b_i k_i\Bigr) y_0 .

    Each stage takes one flow, and the order is that of the tableau in vector spaces. The frame must
    have `cg.frames.Frame.bracket`; dexp⁻¹ is `cg.frames.Frame.dexpinv`, a closed form or its series
    truncated at the order of the method. The error estimate of a step is :math:`e = h \sum_i (b_i -
    \hat b_i) k_i`; it needs no flow.

    Parameters
    ----------
    tableau
        An explicit tableau; with second weights the method is a pair. Or a stiffly accurate
        collocation method of three implicit stages after one at the start, which only the second
        weights use (``"RadauIIA5"``); its stages are solved by Newton's method.
    third
        As for `cg.CommutatorFree`, with the differences e and :math:`e_3` of the result from the
        results of the second and of the third weights.
    name, source
        Name and origin of the method, by default those of the tableau.

    Attributes
    ----------
    tableau
        The flat tableau.
    third_weights
        The third weights.

    Raises
    ------
    MethodError
        If `tableau` isn't such a `Tableau`, its result depends on no stage, it has third
        weights but no second ones, or third weights have a wrong length or equal other weights.

    References
    ----------
    .. [1] H. Munthe-Kaas, "High order Runge-Kutta methods on manifolds", Appl. Numer. Math. 29
       (1999), 115-127.

    Examples
    --------
    >>> heun = MuntheKaas(Tableau([[], [1]], ["1/2", "1/2"], b_embedded=[1, 0]), name="Heun")
    >>> heun.order, heun.embedded_order, heun.exponentials
    (2, 1, 2)
    """

    name: str
    source: str
    tableau: Tableau
    third_weights: tuple[Coefficient, ...] | None
    of_trees: ClassVar[bool] = False

    def __init__(
        self, tableau: Tableau, *, third: Iterable[Any] | None = None, name: str | None = None,
        source: str | None = None,
    ) -> None:  # fmt: skip
        if not isinstance(tableau, Tableau):
            raise MethodError(f"tableau must be a Tableau, got {tableau!r}")
        if not (tableau.explicit or _is_collocation(tableau)):
            raise MethodError(
                "tableau must be explicit, or a stiffly accurate collocation method of three "
                f"implicit stages after one at the start, as RadauIIA5 is, got {tableau!r}"
            )
        values = read_texts(
            tableau.name if name is None else name, tableau.source if source is None else source
        )
        values["tableau"] = tableau
        weights = read_third(third, tableau.stages, tableau.embedded_weights)
        others = tableau.exact[1], tableau.exact_embedded
        if weights and values_of(weights) in others:
            raise MethodError("third must differ from the other weights, or it estimates no error")
        values["third_weights"] = weights
        vars(self).update(values)
        if tableau.explicit:
            check_tree(self.tree)

    def _with(self, coefficients: Sequence[Any], *, third: Any = None, **fields: Any) -> MuntheKaas:
        return MuntheKaas(Tableau.from_layout(self.layout, coefficients, **fields), third=third)

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.tableau, values_of(self.third_weights)

    @cached_property
    def tree(self) -> PointTree:
        """The points of a step: a flow from the initial point to each stage and the result."""
        return tree_of_rows(*self.tableau.exact, flat=True)

    @property
    def explicit(self) -> bool:
        return self.tableau.explicit

    @property
    def layout(self) -> Layout:
        """Positions of the entries in `coefficients`, as in the tableau."""
        return self.tableau.layout

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The coefficients of the tableau."""
        return self.tableau.coefficients

    @property
    def exact_embedded(self) -> tuple[Fraction, ...] | None:
        return self.tableau.exact_embedded

    @property
    def embedded(self) -> MuntheKaas | None:
        """The explicit method with the second weights in place of the first; None without them."""
        second = self.tableau.embedded
        if second is None or not self.explicit:
            return None
        return MuntheKaas(second, name=f"{self.name}, embedded" if self.name else "")

    @cached_property
    def exact_order(self) -> int:
        """The order of the tableau in vector spaces, up to the rounding of its coefficients.

        At most ``conditions.MAX_ORDER``.
        """
        return flat_order(self.tableau)

    @cached_property
    def embedded_order(self) -> int | None:
        return None if self.exact_embedded is None else flat_order(self.tableau, embedded=True)

    @cached_property
    def third_order(self) -> int | None:
        if self.third_weights is None:
            return None
        return flat_order(Tableau(self.tableau.entries, self.third_weights))

    @cached_property
    def advancing_method(self) -> MuntheKaas:
        """The method with the weights of higher order first, with which steps are taken."""
        second = self.tableau.embedded_weights
        if second is None or (self.embedded_order or 0) <= self.order:
            return self
        tableau = Tableau(self.tableau.entries, second, b_embedded=self.tableau.weights)
        return MuntheKaas(tableau, third=self.third_weights, name=self.name, source=self.source)

    @property
    def error_weights(self) -> tuple[tuple[Fraction, ...], ...]:
        """Weights of the error estimates: b minus the second, and b minus the third weights."""
        b = self.tableau.exact[1]
        others = [] if self.exact_embedded is None else [self.exact_embedded]
        if self.third_weights is not None:
            others.append(values_of(self.third_weights))
        return tuple(tuple(x - y for x, y in zip(b, row, strict=True)) for row in others)

    @property
    def pair_exponentials(self) -> int:
        """Number of flows of a step; the error estimate needs none."""
        return self.exponentials

    def satisfies(self, order: int) -> bool:
        """Return whether the classical conditions hold through an order."""
        return self.exact_order >= check_integer("order", order, 1)

    def residuals(self, order: int, *, embedded: bool = False) -> tuple[Fraction, ...]:
        """Return the exact residuals of rooted trees, of the first or the second weights."""
        embedded = check_flag("embedded", embedded)
        a, b = self.tableau.exact
        if embedded and self.exact_embedded is None:
            raise ValueError(f"embedded must be False without second weights, got {self!r}")
        return flat_residuals(a, (embedded and self.exact_embedded) or b, order)


def _is_collocation(tableau: Tableau) -> bool:
    """Return whether a tableau is one of collocation, with a real and two complex eigenvalues."""
    a, b = tableau.exact
    if len(b) != 4 or any(a[0]) or any(row[0] for row in a) or a[-1] != b:
        return False
    inner, k = tableau.a[1:, 1:], np.arange(1, 4)
    c = inner.sum(axis=1)[:, None]
    off = np.abs(inner @ c ** (k - 1) - c**k / k).max()  # integrals of powers
    return bool(off < _QUADRATURE_ROUNDING and np.linalg.eigvals(inner).imag.any())
