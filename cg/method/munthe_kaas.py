"""Runge–Kutta–Munthe-Kaas methods: a flat tableau for the coordinates of a step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from ..structure.layout import Layout
from ..structure.points import START, MethodError, Point, PointTree, check_tree
from ..support.checks import check_flag, check_integer
from .coefficients import Coefficient
from .flat import flat_order
from .low_storage import flat_residuals, rooted_trees
from .method import Method, read_coefficient, read_texts
from .tableau import Tableau

__all__ = ["MuntheKaas"]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class MuntheKaas(Method):
    r"""A Runge–Kutta–Munthe-Kaas method: any explicit tableau of flat order, on a Lie algebra.

    A step solves the equation of coordinates σ of the point, :math:`y = \exp(\sigma)\, y_0`,
    which is one in a linear space, by the tableau as it is [1]_:

    .. math::

        \sigma_i = h \sum_j a_{ij} k_j, \qquad
        k_i = \operatorname{dexp}^{-1}_{\sigma_i} f(t_0 + c_i h, \exp(\sigma_i)\, y_0), \qquad
        y_1 = \exp\Bigl(h \sum_i b_i k_i\Bigr) y_0 .

    So each stage takes one flow, and orders are those of vector spaces. It works on frames with
    `cg.frames.Frame.bracket`; dexp⁻¹ is `cg.frames.Frame.dexpinv`, a closed form or its series
    as far as the order needs it. The error of a step is estimated by :math:`e = h \sum_i (b_i -
    \hat b_i) k_i`, without a flow.

    Parameters
    ----------
    tableau : Tableau
        An explicit one; with second weights it makes a pair.
    third : sequence of s numbers, optional
        Third weights of a pair, of lower order than the second. The estimate is then
        :math:`|e|^2 / \sqrt{|e|^2 + 0.01 |e_3|^2}` with the differences e and :math:`e_3` of the
        result from that of the second and of the third weights, as DOP853 has it [2]_.
    name, source : str, optional
        What the method is called and where it is from; by default what the tableau says.

    Attributes
    ----------
    tableau : Tableau
        The flat tableau.
    third_weights : tuple of Coefficient or None
        The third weights.

    Raises
    ------
    MethodError
        If `tableau` is no explicit `Tableau`, its result depends on no stage, or third weights
        have a wrong length, belong to no pair or equal other ones.

    References
    ----------
    .. [1] H. Munthe-Kaas, "High order Runge-Kutta methods on manifolds", Appl. Numer. Math. 29
       (1999), 115-127.
    .. [2] E. Hairer, S. P. Nørsett, G. Wanner, "Solving Ordinary Differential Equations I", 2nd
       ed., Springer, 1993, section II.5.

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
    nominal_order: int | None
    nominal_residual: Coefficient | None

    def __init__(
        self,
        tableau: Tableau,
        *,
        third: Iterable[Any] | None = None,
        name: str | None = None,
        source: str | None = None,
    ) -> None:
        if not isinstance(tableau, Tableau):
            raise MethodError(f"tableau must be a Tableau, got {tableau!r}")
        if not tableau.explicit:
            raise MethodError(f"tableau must be explicit, got {tableau!r}")
        values = read_texts(
            tableau.name if name is None else name,
            tableau.source if source is None else source,
            (None, None),
        )
        values["tableau"] = tableau
        values["third_weights"] = None if third is None else _read_third(third, tableau)
        for field, value in values.items():
            object.__setattr__(self, field, value)
        check_tree(self.tree)

    @classmethod
    def from_layout(cls, layout: Layout, coefficients: Sequence[Any], **names: Any) -> MuntheKaas:
        """Return the method of a tableau with these entries, row by row."""
        return cls(Tableau.from_layout(layout, coefficients), **names)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what was derived: arrays would come back writeable."""
        return {field.name: self.__dict__[field.name] for field in fields(self)}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MuntheKaas):
            return NotImplemented
        return self.tableau == other.tableau and self.third_weights == other.third_weights

    def __hash__(self) -> int:
        return hash((MuntheKaas, self.tableau, self.third_weights))

    @cached_property
    def tree(self) -> PointTree:
        """The points of a step: a flow from the initial point to each stage and the result."""
        a, b = self.tableau.exact
        return _tree(a, b)

    @property
    def layout(self) -> Layout:
        """Where each coefficient stands in `coefficients`: as in the tableau."""
        return self.tableau.layout

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The coefficients of the tableau."""
        return self.tableau.coefficients

    @property
    def exact_embedded(self) -> tuple[Fraction, ...] | None:
        """The second weights of a pair as Fractions, shape (s,); None without."""
        return self.tableau.exact_embedded

    @cached_property
    def exact_third(self) -> tuple[Fraction, ...] | None:
        """The third weights as Fractions, shape (s,); None without."""
        return None if self.third_weights is None else tuple(w.value for w in self.third_weights)

    @property
    def embedded(self) -> MuntheKaas | None:
        """The method with the second weights in place of the first; None without them."""
        second = self.tableau.embedded
        if second is None:
            return None
        return MuntheKaas(second, name=f"{self.name}, embedded" if self.name else "")

    @cached_property
    def exact_order(self) -> int:
        """The order of the tableau on vector spaces, as far as its stored places can tell.

        At most ``conditions.MAX_ORDER``.
        """
        return flat_order(self.tableau)

    @cached_property
    def embedded_order(self) -> int | None:
        """Order of the second weights, found like `exact_order`; None without."""
        return flat_order(self.tableau, embedded=True) if self.embedded is not None else None

    @cached_property
    def third_order(self) -> int | None:
        """Order of the third weights, found like `exact_order`; None without."""
        if self.third_weights is None:
            return None
        return flat_order(Tableau(self.tableau.entries, self.third_weights))

    @cached_property
    def advancing(self) -> MuntheKaas:
        """The method whose first weights are those of higher order, which make the steps."""
        second = self.tableau.embedded_weights
        if second is None or (self.embedded_order or 0) <= self.order:
            return self
        tableau = Tableau(self.tableau.entries, second, b_embedded=self.tableau.weights)
        return MuntheKaas(tableau, third=self.third_weights, name=self.name, source=self.source)

    @property
    def error_weights(self) -> tuple[tuple[Fraction, ...], ...]:
        """Weights of the error estimates: the first less the second ones, less the third ones."""
        b = self.tableau.exact[1]
        others = [row for row in (self.exact_embedded, self.exact_third) if row is not None]
        return tuple(tuple(x - y for x, y in zip(b, row, strict=True)) for row in others)

    def satisfies(self, order: int) -> bool:
        """Tell whether the conditions of vector spaces hold through an order."""
        return self.exact_order >= check_integer("order", order, 1)

    def residuals(self, order: int, *, embedded: bool = False) -> tuple[Fraction, ...]:
        """Return ``Φ(t) - 1/γ(t)`` for rooted trees through an order, which are exact.

        Parameters
        ----------
        order : int
            At least 1.
        embedded : bool, optional
            Of the second weights.
        """
        embedded = check_flag("embedded", embedded)
        a, b = self.tableau.exact
        if embedded and self.exact_embedded is None:
            raise ValueError(f"embedded: {self!r} has no second result")
        return flat_residuals(_tree(a, (embedded and self.exact_embedded) or b), order)

    def largest_residual(self, order: int | None = None) -> float:
        """Return the largest ``|Φ(t) - 1/γ(t)|`` of rooted trees, by default through `order`."""
        return float(max(map(abs, self.residuals(self.order if order is None else order))))

    def principal_error(self, order: int | None = None) -> float:
        """Return the Euclidean norm of the residuals of rooted trees of order q + 1.

        Parameters
        ----------
        order : int, optional
            q, by default the method's own order.
        """
        order = self.order if order is None else check_integer("order", order, 0)
        lower = len(rooted_trees(order)) if order else 0
        return float(np.linalg.norm([float(r) for r in self.residuals(order + 1)[lower:]]))


def _tree(a: Sequence[Sequence[Fraction]], b: Sequence[Fraction]) -> PointTree:
    """Return a point for each different row that isn't zero."""
    index: dict[tuple[Fraction, ...], int] = {}

    def point(row: Sequence[Fraction]) -> int:
        return index.setdefault(tuple(row), len(index)) if any(row) else START

    stages = tuple(map(point, a))
    result = point(b)
    points = tuple(Point(START, dict(enumerate(row))) for row in index)
    return PointTree(points, stages, result)


def _read_third(third: Iterable[Any], tableau: Tableau) -> tuple[Coefficient, ...]:
    if tableau.embedded_weights is None:
        raise MethodError("third must be None unless the tableau has second weights")
    if isinstance(third, str) or not isinstance(third, Iterable):
        raise MethodError(f"third must be a sequence of numbers, got {third!r}")
    weights = tuple(read_coefficient(w, f"third_{i}") for i, w in enumerate(third, 1))
    if len(weights) != tableau.stages:
        raise MethodError(f"third must have {tableau.stages} entries, got {len(weights)}")
    values = tuple(w.value for w in weights)
    if values in (tableau.exact[1], tableau.exact_embedded):
        raise MethodError("third must differ from the other weights, or it estimates no error")
    return weights
