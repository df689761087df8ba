"""Magnus methods: products of exponentials for linear equations, with or without brackets."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import Legendre

from cg.construction.conditions.linear_equations import (
    LINEAR_ROUNDING,
    MAX_LINEAR_ORDER,
    Values,
    linear_residuals,
    linear_sensitivities,
)
from cg.construction.layouts import Layout
from cg.construction.methods.coefficients import (
    Coefficient,
    read_coefficient,
    read_row,
    read_sequence,
    read_texts,
    read_third,
    values_of,
)
from cg.construction.methods.method import Method
from cg.construction.methods.tolerance import TOLERANCE_FACTOR
from cg.construction.points import START, MethodError, Point, PointTree

LOBATTO = "Lobatto's formula"
"""Name of the method of `lobatto`, which isn't listed."""


@dataclass(frozen=True, init=False, eq=False, repr=False)
class MagnusMethod(Method):
    r"""A Magnus method for linear equations, commutator-free [1]_ or with brackets [2]_.

    A step of :math:`y' = \sum_i a_i(t) E_i(y)` evaluates the coefficients at the nodes,
    :math:`F_k = a(t_0 + c_k h)`, and follows flows one after the other,

    .. math::

        y_1 = \exp\Bigl(h \sum_k a_{sk} F_k\Bigr) \cdots \exp\Bigl(h \sum_k a_{1k} F_k\Bigr) y_0 .

    No stage depends on a point, so there are fewer order conditions, one for each word in the
    derivatives of a, and fewer flows than a Runge–Kutta method needs. With brackets one flow is
    enough: :math:`F_{K+j} = h\, [\sum_k u_{jk} F_k, \sum_k v_{jk} F_k]` is the bracket j of two
    combinations of the fields before it, and flows combine it like the others.

    Parameters
    ----------
    nodes
        Sequence of K numbers. The nodes c, as `Coefficient.read` takes them.
    weights
        Rows, one for each flow, of K numbers, with B brackets of K + B. The weights of each flow,
        in the order in which flows are followed.
    embedded
        Rows of such numbers. The flows of a second result, of lower order, from the initial point.
        If that and the first result have one flow each, only the exponents are compared: their
        difference bounds that of the results on compact groups.
    brackets
        Pairs of rows ``(u, v)`` of K numbers, K + 1 in the second pair, and so on. A frame has to
        have a `Frame.bracket`.
    third
        Sequence of such numbers. The weights of one flow from the initial point to a third result.
        If the second result is :math:`e_2` from the first, and the third :math:`e_3`, the estimate
        of the error is :math:`e_2 (e_2 / \sqrt{e_2^2 + c^2 e_3^2})^n`, with n such that it has the
        order of the method: the sum of one of the differences of quadratures, and one of the rest.
    third_factor
        The factor c, positive. The smaller the method's own error, the larger it is.
    name, source
        Name and origin of the method.

    Raises
    ------
    MethodError
        If there is no node, no flow, a row has another length than there are nodes, or an entry
        is no finite number; if there are third weights, but no second result; if ``third_factor``
        isn't positive.

    References
    ----------
    .. [1] A. Alvermann, H. Fehske, "High-order commutator-free exponential time-propagation of
       driven quantum systems", J. Comput. Phys. 230 (2011), 5930-5956.
    .. [2] S. Blanes, F. Casas, J. Ros, "High order optimized geometric integrators for linear
       differential equations", BIT 42 (2002), 262-284.

    Examples
    --------
    >>> midpoint = MagnusMethod(["1/2"], [[1]], name="exponential midpoint rule")
    >>> midpoint.order, midpoint.stages, midpoint.exponentials
    (2, 1, 1)
    """

    name: str
    source: str
    nodes: tuple[Coefficient, ...]
    weights: tuple[tuple[Coefficient, ...], ...]
    embedded_weights: tuple[tuple[Coefficient, ...], ...] | None
    brackets: tuple[tuple[tuple[Coefficient, ...], ...], ...]
    third_weights: tuple[Coefficient, ...] | None
    third_factor: Coefficient
    of_trees: ClassVar[bool] = False

    def __init__(
        self, nodes: Iterable[Any], weights: Iterable[Iterable[Any]],
        embedded: Iterable[Iterable[Any]] | None = None, *,
        brackets: Iterable[Iterable[Iterable[Any]]] = (), third: Iterable[Any] | None = None,
        third_factor: Any = 1, name: str = "", source: str = "",
    ) -> None:  # fmt: skip
        values = read_texts(name, source)
        values["nodes"] = read_row(nodes, "nodes")
        count = len(values["nodes"])
        values["brackets"] = pairs = _pairs(brackets, count)
        count += len(pairs)
        values["weights"] = _rows(weights, "weights", count)
        values["embedded_weights"] = second = (
            None if embedded is None else _rows(embedded, "embedded", count)
        )
        values["third_weights"] = read_third(third, count, second)
        values["third_factor"] = factor = read_coefficient(third_factor, "third_factor")
        if factor.value <= 0:
            raise MethodError(f"third_factor must be positive, got {third_factor!r}")
        vars(self).update(values)

    def _with(self, coefficients: Sequence[Any], **fields: Any) -> MagnusMethod:
        """Return the method with other nodes and weights, and the same third ones."""
        nodes, brackets, weights, second = self.with_numbers(coefficients, 0)
        same: dict[str, Any] = {"third": self.third_weights, "third_factor": self.third_factor}
        same["brackets"] = brackets
        return MagnusMethod(nodes, weights, second or None, **(same | fields))

    @property
    def _key(self) -> tuple[Any, ...]:
        third = self.third_weights, self.third_factor
        rows = self.nodes, self.brackets, self.weights, self.embedded_weights, *third
        return tuple(map(values_of, rows))

    @cached_property
    def tree(self) -> PointTree:
        """The points on the way to both results; stages are at the initial point.

        Weights on brackets follow those on stages. A second result is left out where exponents are
        compared.
        """
        points: list[Point] = []
        results = []
        second_rows = () if self.by_exponents else self.embedded_weights or ()
        for rows in (self.weights, second_rows):
            parent = START
            for row in rows:
                points.append(Point(parent, {k: a.value for k, a in enumerate(row)}))
                parent = len(points) - 1
            results.append(parent)
        second = results[1] if second_rows else None
        return PointTree(tuple(points), (START,) * len(self.nodes), results[0], second)

    @property
    def _order_in_words(self) -> str:
        if self.name == LOBATTO:  # only along polynomials it has the order of its quadrature
            return f"{2 * self.stages - 2} along a polynomial"
        return super()._order_in_words

    @property
    def by_exponents(self) -> bool:
        """Whether errors are estimated by differences of exponents: both results have one flow."""
        return len(self.weights) == len(self.embedded_weights or ()) == 1

    @property
    def error_weights(self) -> tuple[tuple[Fraction, ...], ...]:
        """Weights of the parts of error estimates that are sums over stages.

        With a third result the rows are the differences of the quadratures, where all values of
        `f` commute, of the first result from the second and from the third; where exponents are
        compared, each row is followed by a row for the brackets. Without a third result there is
        one row, the difference of the exponents, if there is one.
        """
        third, stages = self.third_weights, len(self.nodes)
        if not self.embedded_weights or not (self.by_exponents or third):
            return ()
        results = self.weights, self.embedded_weights, *([(third,)] if third else [])
        first, *others = (
            [sum(a.value for a in column) for column in zip(*flows, strict=True)]
            for flows in results
        )
        rows = [[a - b for a, b in zip(first, other, strict=True)] for other in others]
        parts = [range(stages), range(stages, len(first))] if third else [range(len(first))]
        return tuple(
            tuple(a if k in part else Fraction(0) for k, a in enumerate(row))
            for row in rows
            for part in parts[: 1 + self.by_exponents]
        )

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The nonzero nodes, weights of brackets, and weights of the flows of both results."""
        return tuple(a for row in self.rows for a in row if a.value != 0)

    @property
    def rows(self) -> tuple[tuple[Coefficient, ...], ...]:
        """The nodes, both sides of each bracket, and the weights of both results."""
        sides = [side for pair in self.brackets for side in pair]
        return self.nodes, *sides, *self.weights, *(self.embedded_weights or ())

    def filled(self, numbers: Sequence[Any], zero: Any) -> list[list[Any]]:
        """Return rows like `rows`, with numbers in place of `coefficients`."""
        each = iter(numbers)
        return [[next(each) if x.value else zero for x in row] for row in self.rows]

    def with_numbers(self, numbers: Sequence[Any], zero: Any) -> tuple[Any, Any, Any, Any]:
        """Return nodes, pairs of sides of brackets, and both weights, from `filled`."""
        rows = self.filled(numbers, zero)
        pairs = 1 + 2 * len(self.brackets)
        first = pairs + len(self.weights)
        brackets = list(zip(rows[1:pairs:2], rows[2:pairs:2], strict=True))
        return rows[0], brackets, rows[pairs:first], rows[first:]

    @cached_property
    def layout(self) -> Layout:
        """Positions of the nonzero nodes and weights in `coefficients`; see `Layout.of_time`.

        There is none of a method with brackets: AttributeError.
        """
        if self.brackets:
            raise AttributeError(f"{self!r} has brackets, and no layout")
        flows = Layout.of_tree(self.tree)
        moved = [k for k, node in enumerate(self.nodes) if node.value]
        parents = (m if m == START else m + len(moved) for m in flows.parents)
        return Layout(
            (*(START for _ in moved), *parents),
            (*((k,) for k in moved), *flows.weights),
            tuple(moved.index(k) if k in moved else START for k in range(self.stages)),
            tuple(m + len(moved) for m in flows.results),
            of_time=True,
        )

    @cached_property
    def embedded(self) -> MagnusMethod | None:
        if self.embedded_weights is None:
            return None
        second = self.embedded_weights
        return MagnusMethod(self.nodes, second, brackets=self.brackets, **self._embedded_names)

    @cached_property
    def third_order(self) -> int | None:
        if self.third_weights is None:
            return None
        return MagnusMethod(self.nodes, [self.third_weights], brackets=self.brackets).order

    @property
    def third_flow(self) -> tuple[Coefficient, ...] | None:
        return None if self.by_exponents else self.third_weights

    @cached_property
    def abscissae(self) -> tuple[Fraction, ...]:
        """The nodes as Fractions."""
        return tuple(node.value for node in self.nodes)

    @cached_property
    def exact_order(self) -> int:
        """The order for linear equations, as far as the stored places can tell."""
        orders = range(1, MAX_LINEAR_ORDER + 1)
        return next((q - 1 for q in orders if not self.satisfies(q)), MAX_LINEAR_ORDER)

    def residuals(self, order: int) -> list[Decimal]:
        """Return the residuals of the conditions of all words through a degree, to 50 digits."""
        return linear_residuals(self._numbers("value"), order)

    def satisfies(self, order: int) -> bool:
        """Tell whether the conditions through an order hold, as far as stored places can tell."""
        bounds = linear_sensitivities(self._numbers("value"), self._numbers("unit"), order)
        return all(
            abs(residual) <= TOLERANCE_FACTOR * bound + LINEAR_ROUNDING
            for residual, bound in zip(self.residuals(order), bounds, strict=True)
        )

    def _numbers(self, kind: str) -> Values:
        """Return nodes, weights and brackets as their values or units."""
        nodes, weights, brackets = values_of((self.nodes, self.weights, self.brackets), kind)
        return nodes, weights, brackets


def _rows(rows: Any, label: str, count: int) -> tuple[tuple[Coefficient, ...], ...]:
    listed = read_sequence(rows, label, of=" of rows")
    if not listed:
        raise MethodError(f"{label} must have at least one row, got none")
    return tuple(read_row(row, f"{label}[{i}]", count) for i, row in enumerate(listed))


def _pairs(pairs: Any, count: int) -> tuple[tuple[tuple[Coefficient, ...], ...], ...]:
    """Return the two sides of each bracket, which combine `count` nodes and earlier brackets."""
    read = []
    for j, pair in enumerate(read_sequence(pairs, "brackets", of=" of pairs of rows")):
        label = f"brackets[{j}]"
        rows = _rows(pair, label, count + j)
        if len(rows) != 2:
            raise MethodError(f"{label} must have two rows, got {len(rows)}")
        read.append(rows)
    return tuple(read)


def lobatto(nodes: int) -> MagnusMethod:
    """Return the method whose only flow has the nodes and weights of Lobatto's formula."""
    legendre = Legendre.basis(nodes - 1)
    x = np.array([-1.0, *np.real(legendre.deriv().roots()), 1.0])
    weights = 1 / (nodes * (nodes - 1) * legendre(x) ** 2)
    at, flow = ([f"{number:.16f}" for number in row] for row in ((x + 1) / 2, weights))
    return MagnusMethod(at, [flow], name=LOBATTO)
