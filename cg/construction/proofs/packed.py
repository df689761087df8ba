"""A method as a vector of coefficients, and its order conditions as equations of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

from cg.construction.conditions.word_weights import EquationSystem
from cg.construction.conditions.words import (
    Condition,
    Word,
    condition_words,
    conditions_of,
    is_of_time,
    nodes,
)
from cg.construction.layouts.layout import Layout
from cg.construction.methods.coefficients import Coefficient
from cg.construction.proofs.certificate import Box
from cg.support import flint
from cg.support.balls import to_ball


class Equations(Protocol):
    """Conditions as equations of coefficients, such as an `EquationSystem`."""

    def residuals(self, z: Sequence[Any]) -> list[Any]:
        """Return the residuals, for coefficients that are all ``arb`` or all ``fmpq``."""

    def linearise(self, z: Sequence[flint.arb]) -> tuple[list[flint.arb], flint.arb_mat]:
        """Return the residuals and their derivatives by all coefficients."""


@dataclass(frozen=True)
class PolynomialEquations:
    """Equations by a function of coefficients of any type of numbers."""

    residuals: Callable[[Sequence[Any]], list[Any]]

    def linearise(self, z: Sequence[flint.arb]) -> tuple[list[flint.arb], flint.arb_mat]:
        """Return the residuals and their derivatives by all coefficients."""
        columns = []
        for k in range(len(z)):
            line = [flint.arb_series([x, int(j == k)], prec=2) for j, x in enumerate(z)]
            columns.append([value[1] for value in self.residuals(line)])
        return self.residuals(z), flint.arb_mat(columns).transpose()


@dataclass(frozen=True)
class Packed(ABC):
    """A method as a vector of coefficients, with the orders of its results."""

    name: str
    coefficients: tuple[Coefficient, ...]
    orders: tuple[int, ...]

    @property
    @abstractmethod
    def names(self) -> list[str]:
        """The names of the coefficients."""

    @property
    @abstractmethod
    def conditions(self) -> list[Condition]:
        """The independent conditions of all rows of weights."""

    @abstractmethod
    def equations(self, conditions: Sequence[Condition]) -> Equations:
        """Return some conditions as equations."""

    @abstractmethod
    def words(self, order: int) -> list[Word]:
        """Return the words of the independent conditions of one order."""

    def has(self, word: Word) -> bool:
        """Return whether a word is one of a condition of the method."""
        return word in self.words(nodes(word))

    def spread(self, z: Sequence[Any]) -> Sequence[Any]:
        """Return all coefficients of the method."""
        return z

    def system(self, left_out: Sequence[Condition] = ()) -> Equations:
        """Return the conditions as equations, without those that are left out."""
        omitted = set(left_out)
        return self.equations([one for one in self.conditions if one not in omitted])

    def balls(self) -> list[flint.arb]:
        """Return balls, as small as the precision allows, that hold the values."""
        return [to_ball(coefficient.value) for coefficient in self.coefficients]

    def movable(self, box: Box) -> list[int]:
        """Return the indices of the coefficients that aren't fixed."""
        held = set(box.fixed)
        return [k for k, name in enumerate(self.names) if name not in held]

    def enclosure(self, box: Box) -> list[flint.arb]:
        """Return balls that hold the exact solution."""
        y = self.balls()
        radius = to_ball(Fraction(box.radius)).upper()
        for k in self.movable(box):
            y[k] = y[k] + flint.arb(0, radius)
        return y


@dataclass(frozen=True)
class PackedWeights(Packed):
    """A method of stages and flows as its weights, point by point; conditions may be dependent."""

    layout: Layout

    @property
    def names(self) -> list[str]:
        return self.layout.names

    @property
    def conditions(self) -> list[Condition]:
        return conditions_of(self.orders, self.layout.of_time)

    def equations(self, conditions: Sequence[Condition]) -> EquationSystem:
        return EquationSystem(self.layout, tuple(conditions))

    def words(self, order: int) -> list[Word]:
        every = condition_words(order, True, self.layout.of_time)
        return [word for word in every if nodes(word) == order]

    def has(self, word: Word) -> bool:
        return not self.layout.of_time or is_of_time(word)
