"""The base class of properties of a method by which conditions depend on others."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from fractions import Fraction

from flint import arb

from ...structure.layout import Layout
from ..systems import Equation, nearly_satisfied
from .orthogonality import Condition, ResidualRelation


class MethodStructure(ABC):
    """A property of a method by which conditions depend on others, beside orthogonality.

    `orders` are those of the rows of weights, `x` the packed coefficients.
    """

    assumed: tuple[Condition, ...] = ()
    """Conditions that the relations assume; they can't be left out."""

    def __init__(self, layout: Layout, orders: Sequence[int], x: Sequence[Fraction]) -> None:
        self._layout, self._orders, self._x = layout, orders, x

    def possible(self) -> bool:
        """Return whether the equations exist for this layout; else it isn't `satisfied`."""
        return True

    def satisfied(self) -> bool:
        """Return whether the method has the property, as far as its digits can tell."""
        return self.possible() and nearly_satisfied(self._layout, self.equations(), self._x)

    @abstractmethod
    def equations(self) -> list[Equation]:
        """Return the equations that define the property."""

    @abstractmethod
    def relations(self, y: Sequence[arb]) -> Iterator[ResidualRelation]:
        """Yield combinations of residuals that are zero then, for coefficients in the balls y."""
