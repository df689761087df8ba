"""Commutator-free Magnus methods: products of exponentials for linear equations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.conditions.linear_equations import (
    LINEAR_ROUNDING,
    estimated_order,
    linear_residuals,
    linear_sensitivities,
)
from cg.method.coefficients import (
    Coefficient,
    read_coefficient,
    read_row,
    read_sequence,
    read_texts,
)
from cg.method.method import Method, frozen
from cg.method.tolerance import TOLERANCE_FACTOR
from cg.structure.layout import Layout
from cg.structure.points import START, MethodError, Point, PointTree


@dataclass(frozen=True, init=False, eq=False, repr=False)
class MagnusMethod(Method):
    r"""A commutator-free Magnus method for linear equations [1]_.

    A step of :math:`y' = \sum_i a_i(t) E_i(y)` evaluates the coefficients at the nodes,
    :math:`F_k = a(t_0 + c_k h)`, and follows flows one after the other,

    .. math::

        y_1 = \exp\Bigl(h \sum_k a_{sk} F_k\Bigr) \cdots \exp\Bigl(h \sum_k a_{1k} F_k\Bigr) y_0 .

    No stage depends on a point, so there are fewer order conditions, one for each word in the
    derivatives of a, and fewer flows than a Runge–Kutta method needs.

    Parameters
    ----------
    nodes
        Sequence of K numbers. The nodes c, as `Coefficient.read` takes them.
    weights
        Rows, one for each flow, of K numbers. The weights of each flow, in the order in which flows
        are followed.
    embedded
        Rows of K numbers. The flows of a second result, of lower order, from the initial point.
    third
        Sequence of K numbers. The weights of one flow from the initial point to a third result. If
        the second result is :math:`e_2` from the first, and the third :math:`e_3`, the estimate of
        the error is :math:`e_2 (e_2 / \sqrt{e_2^2 + c^2 e_3^2})^n`, with n such that it has the
        order of the method.
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
    third_weights: tuple[Coefficient, ...] | None
    third_factor: Coefficient

    def __init__(
        self,
        nodes: Iterable[Any],
        weights: Iterable[Iterable[Any]],
        embedded: Iterable[Iterable[Any]] | None = None,
        *,
        third: Iterable[Any] | None = None,
        third_factor: Any = 1,
        name: str = "",
        source: str = "",
    ) -> None:
        values = read_texts(name, source, (None, None))
        values["nodes"] = read_row(nodes, "nodes")
        count = len(values["nodes"])
        values["weights"] = _rows(weights, "weights", count)
        values["embedded_weights"] = None
        if embedded is not None:
            values["embedded_weights"] = _rows(embedded, "embedded", count)
        elif third is not None:
            raise MethodError("third must be None unless there is a second result")
        values["third_weights"] = None if third is None else read_row(third, "third", count)
        values["third_factor"] = factor = read_coefficient(third_factor, "third_factor")
        if factor.value <= 0:
            raise MethodError(f"third_factor must be positive, got {third_factor!r}")
        self._set(values)

    @classmethod
    def from_layout(
        cls, layout: Layout, coefficients: Sequence[Any], **fields: Any
    ) -> MagnusMethod:
        """Return the method with a layout and packed nodes and weights."""
        packed = layout.point_weights(coefficients)
        stages = range(layout.stages)
        nodes = [0 if at == START else packed[at][k] for k, at in enumerate(layout.stage_points)]
        first = layout.stages - layout.stage_points.count(START)
        rows = [[weights.get(k, 0) for k in stages] for weights in packed[first:]]
        flows = layout.results[0] + 1 - first
        second = rows[flows:] if layout.pair else None
        return cls(nodes, rows[:flows], second, **fields)

    def with_coefficients(self, coefficients: Sequence[Any], **fields: Any) -> MagnusMethod:
        """Return the method with other nodes and weights, and the same third ones."""
        same = {"third": self.third_weights, "third_factor": self.third_factor}
        return super().with_coefficients(coefficients, **(same | fields))

    @property
    def _key(self) -> tuple[Any, ...]:
        third = self.third_weights, self.third_factor
        return self.nodes, self.weights, self.embedded_weights, *third

    @cached_property
    def tree(self) -> PointTree:
        """The points on the way to both results; stages are at the initial point."""
        points: list[Point] = []
        results = []
        for rows in (self.weights, self.embedded_weights or ()):
            parent = START
            for row in rows:
                points.append(Point(parent, {k: a.value for k, a in enumerate(row)}))
                parent = len(points) - 1
            results.append(parent)
        second = None if self.embedded_weights is None else results[1]
        return PointTree(tuple(points), (START,) * len(self.nodes), results[0], second)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The nodes and weights that aren't zero, flow after flow, those of both results."""
        rows = (self.nodes, *self.weights, *(self.embedded_weights or ()))
        return tuple(a for row in rows for a in row if a.value != 0)

    @cached_property
    def layout(self) -> Layout:
        """Positions of the nonzero nodes and weights in `coefficients`; see `Layout.of_time`."""
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
        name = f"{self.name}, embedded" if self.name else ""
        return MagnusMethod(self.nodes, self.embedded_weights, name=name, source=self.source)

    @cached_property
    def third_order(self) -> int | None:
        if self.third_weights is None:
            return None
        return MagnusMethod(self.nodes, [self.third_weights]).order

    @cached_property
    def pair_exponentials(self) -> int:
        return super().pair_exponentials + (self.third_weights is not None)

    @cached_property
    def abscissae(self) -> tuple[Fraction, ...]:
        """The nodes as Fractions."""
        return tuple(node.value for node in self.nodes)

    @cached_property
    def c(self) -> NDArray[np.float64]:
        """The nodes, rounded to double; shape (K,), read-only."""
        return frozen(self.abscissae)

    @cached_property
    def exact_order(self) -> int:
        """The order for linear equations, as far as the stored places can tell."""
        orders = range(estimated_order(self.abscissae, self._values), 0, -1)
        return next((order for order in orders if self.satisfies(order)), 0)

    def residuals(self, order: int) -> list[Decimal]:
        """Return the residuals of the conditions of all words through a degree, to 50 digits."""
        return linear_residuals(self.abscissae, self._values, order)

    def _next_residuals(self) -> NDArray[np.float64]:
        return np.array(self.residuals(self.order + 1)[2**self.order - 1 :], dtype=np.float64)

    def satisfies(self, order: int) -> bool:
        """Tell whether the conditions through an order hold, as far as stored places can tell."""
        units = [[a.unit for a in row] for row in self.weights]
        node_units = [node.unit for node in self.nodes]
        bounds = linear_sensitivities(self.abscissae, self._values, node_units, units, order)
        return all(
            abs(residual) <= TOLERANCE_FACTOR * bound + LINEAR_ROUNDING
            for residual, bound in zip(self.residuals(order), bounds, strict=True)
        )

    @property
    def _values(self) -> list[list[Fraction]]:
        return [[a.value for a in row] for row in self.weights]


def _rows(rows: Any, label: str, count: int) -> tuple[tuple[Coefficient, ...], ...]:
    listed = read_sequence(rows, label, of=" of rows")
    if not listed:
        raise MethodError(f"{label} must have at least one row, got none")
    return tuple(read_row(row, f"{label}[{i}]", count) for i, row in enumerate(listed))
