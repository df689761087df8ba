"""The order of a method: its order conditions and their residuals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cg.construction import conditions
from cg.construction.layouts.layout import Layout
from cg.construction.layouts.points import MethodError, PointTree
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.tolerance import satisfies, to_floats, tolerance
from cg.support.checks import check_integer


class Orders(ABC):
    """Order, residuals and principal error of a method with rounded coefficients."""

    nominal_order: int | None = None
    nominal_residual: Coefficient | None = None

    if TYPE_CHECKING:  # fields in some subclasses, cached properties in others

        @property
        def tree(self) -> PointTree:
            """The points of a step."""

        @property
        def coefficients(self) -> tuple[Coefficient, ...]:
            """All coefficients."""

    @property
    @abstractmethod
    def layout(self) -> Layout:
        """Positions of the weights in `coefficients`."""

    @property
    def order(self) -> int:
        """The order: `nominal_order` if the method is `approximate`, else `exact_order`."""
        return self.exact_order if self.nominal_order is None else self.nominal_order

    @property
    def approximate(self) -> bool:
        """Whether `order` is only nominal: the order conditions hold approximately."""
        return self.nominal_order is not None

    @cached_property
    def exact_order(self) -> int:
        """The order of the method, up to the rounding of its coefficients.

        The largest q (0 to ``conditions.MAX_ORDER``) such that every condition through
        order q has an exact residual no larger than `TOLERANCE_FACTOR` times
        ``Σ_k |∂Φ/∂x_k| u_k``, where u_k is the uncertainty of coefficient k
        (`Coefficient.unit`). The tolerance is 0 for rational coefficients.
        """
        orders = range(1, conditions.MAX_ORDER + 1)
        return next((q - 1 for q in orders if not self.satisfies(q)), orders[-1])

    def residuals(self, order: int) -> Sequence[Any]:
        """Return the exact residuals ``Φ(t) - 1/γ(t)`` of all trees through an order.

        Returns
        -------
        tuple of Fraction
            Of the ordered trees `cg.conditions.condition_trees`; of a `cg.MuntheKaas` the classical
            ones. Those of a `cg.MagnusMethod` are Decimals of 50 digits, of words; see
            `cg.Splitting.residuals` too.

        Examples
        --------
        >>> import crouch_grossman as cg
        >>> trees = map(cg.construction.trees.forest(5).tree, cg.conditions.condition_trees(4))
        >>> residuals = cg.methods["CG3"].residuals(4)
        >>> [str(t) for t, r in zip(trees, residuals, strict=True) if abs(r) > 0.05]
        ['[[][[[]]]]', '[[[[]]][]]']
        """
        return conditions.residuals(self.tree, order, arithmetic="exact")

    def largest_residual(self, order: int | None = None) -> float:
        """Return the magnitude of the largest residual through an order.

        Parameters
        ----------
        order
            By default the method's own order, or 1 if it has none.
        """
        return float(max(map(abs, self.residuals(max(self.order, 1) if order is None else order))))

    @cached_property
    def principal_error(self) -> float:
        """Euclidean norm of the residuals of order q + 1, q the order: all trees, q + 2 nodes.

        A ValueError if q is ``conditions.MAX_ORDER``.
        """
        return float(np.linalg.norm(self._next_residuals()))

    def _next_residuals(self) -> NDArray[np.float64]:
        lower = conditions.count(self.order) if self.order else 0
        return conditions.residuals(self.tree, self.order + 1)[lower:]

    def satisfies(self, order: int) -> bool:
        """Return whether the conditions through an order hold, up to the rounding of coefficients.

        The tolerance is that of `exact_order`.
        """
        order = check_integer("order", order, 1)
        return satisfies(self.tree, self.layout, self.coefficients, order)

    def tolerance(self, order: int) -> NDArray[np.float64]:
        """Return the largest residuals through an order that rounded coefficients may cause.

        Returns
        -------
        ndarray, shape (conditions.count(order, independent=True),)
            See `exact_order`; zeros for rational coefficients.
        """
        return tolerance(self.layout, self.coefficients, order)

    def _check_nominal_order(self, error: type[MethodError]) -> None:
        """Raise the error if residuals through a nominal order exceed the nominal residual."""
        if self.nominal_residual is None:
            return
        try:
            residuals = conditions.residuals(self.layout, to_floats(self.coefficients), self.order)
        except (TypeError, ValueError) as problem:
            raise error(f"nominal_order: {problem}") from None
        largest = float(np.abs(residuals).max())
        if not largest <= float(self.nominal_residual.value):
            raise error(
                f"residuals through nominal_order {self.order} reach {largest:.3g}, "
                f"more than nominal_residual = {self.nominal_residual.text}"
            )
