"""Problems with quadratic equations, whose reference solutions are Taylor series."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from cg.problems.taylor import QuadraticSystem, Reference, Time, reference_solution
from cg.support import flint
from cg.support.balls import to_ball


class Polynomial:
    """A polynomial in the unknowns, with balls as coefficients.

    Arrays of polynomials let equations be written as formulas of NumPy. `terms` has the coefficient
    of each product of unknowns, given by their indices in increasing order.
    """

    def __init__(self, terms: dict[tuple[int, ...], flint.arb]) -> None:
        self.terms = terms

    @classmethod
    def of(cls, value: Polynomial | flint.arb | float) -> Polynomial:
        """Return a polynomial or a constant as a polynomial."""
        if isinstance(value, Polynomial):
            return value
        return cls({(): to_ball(value)})

    def __add__(self, other: Polynomial | flint.arb | float) -> Polynomial:
        if isinstance(other, np.ndarray):
            return NotImplemented
        terms = dict(self.terms)
        for indices, coefficient in Polynomial.of(other).terms.items():
            terms[indices] = terms.get(indices, flint.arb()) + coefficient
        return Polynomial(terms)

    def __mul__(self, other: Polynomial | flint.arb | float) -> Polynomial:
        if isinstance(other, np.ndarray):
            return NotImplemented
        terms: dict[tuple[int, ...], flint.arb] = {}
        for (p, a), (q, b) in product(self.terms.items(), Polynomial.of(other).terms.items()):
            indices = tuple(sorted((*p, *q)))
            terms[indices] = terms.get(indices, flint.arb()) + a * b
        return Polynomial(terms)

    def __neg__(self) -> Polynomial:
        return self * -1.0

    def __sub__(self, other: Polynomial | flint.arb | float) -> Polynomial:
        return self + -Polynomial.of(other)

    def __rsub__(self, other: flint.arb | float) -> Polynomial:
        return -self + other

    __radd__ = __add__
    __rmul__ = __mul__


class QuadraticProblem(ABC):
    """A problem with quadratic equations, which Taylor series solve to any precision."""

    @abstractmethod
    def _initial(self) -> Sequence[flint.arb]:
        """Return the unknowns at time zero, computed with the working precision."""

    @abstractmethod
    def _derivatives(self, y: Any) -> Any:
        """Return the derivatives of the unknowns, as `y` an array of `Polynomial`."""

    def _system(self) -> QuadraticSystem:
        initial = tuple(self._initial())
        unknowns = np.array([Polynomial({(i,): flint.arb(1)}) for i in range(len(initial))])
        equations = [
            tuple((c, indices) for indices, c in Polynomial.of(derivative).terms.items() if c != 0)
            for derivative in self._derivatives(unknowns)
        ]
        if any(len(indices) > 2 for terms in equations for _, indices in terms):
            raise ValueError(f"the equations of {self!r} must be quadratic")
        return QuadraticSystem(tuple(equations), initial)

    def reference(self, times: Sequence[Time], *, bits: int = 256) -> Reference:
        """Return the solution at given times in extended precision, with an error estimate.

        It is computed by Taylor series, without any method on manifolds.

        Parameters
        ----------
        times
            Positive or negative, in any order; a float stands for its exact binary value, a string
            for a decimal number or a quotient.
        bits
            Working precision.

        Returns
        -------
        Reference
            The unknowns are the entries of the point in C order, then those that the class names.

        Raises
        ------
        TypeError, ValueError
            If ``bits`` isn't an integer; if a time isn't a finite number, or ``bits`` is less than
            2.
        """
        return reference_solution(self._system, times, bits=bits)


def balls(values: Sequence[float]) -> Any:
    """Return numbers as an array of exact balls."""
    return np.array([to_ball(x) for x in values])


def identity() -> list[flint.arb]:
    """Return the entries of the identity matrix of three rows."""
    return [flint.arb(int(i == j)) for i in range(3) for j in range(3)]
