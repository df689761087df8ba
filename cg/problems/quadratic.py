"""Problems with quadratic equations, whose reference solutions are Taylor series."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.problems.taylor import QuadraticSystem, Reference, Time, reference_solution
from cg.support import flint
from cg.support.arrays import real_array
from cg.support.balls import to_ball


class QuadraticProblem(ABC):
    """A problem with quadratic equations, which Taylor series solve to any precision."""

    @abstractmethod
    def _initial(self) -> Sequence[flint.arb]:
        """Return the unknowns at time zero, computed with the working precision."""

    @abstractmethod
    def _derivatives(self, y: Any) -> Any:
        """Return the derivatives of the unknowns, for an array ``y`` of balls."""

    def _system(self) -> QuadraticSystem:
        """Return the terms of the equations, from their values where one or two unknowns are 1."""
        initial = tuple(self._initial())

        def value(*ones: int) -> Any:
            y = np.array([flint.arb(ones.count(i)) for i in range(len(initial))])
            return np.array([*map(to_ball, self._derivatives(y))])

        constant, units = value(), [value(i) for i in range(len(initial))]
        terms: dict[tuple[int, ...], Any] = {(): constant}
        for i, at_i in enumerate(units):
            square = (value(i, i) - 2 * at_i + constant) / 2
            terms[i, i], terms[(i,)] = square, at_i - constant - square
            for j in range(i):
                terms[j, i] = value(i, j) - at_i - units[j] + constant
        equations = tuple(
            tuple((c[k], indices) for indices, c in terms.items() if c[k] != 0)
            for k in range(len(initial))
        )
        return QuadraticSystem(equations, initial)

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
        """
        return reference_solution(self._system, times, bits=bits)


def balls(values: Sequence[float]) -> Any:
    """Return numbers as an array of exact balls."""
    return np.array([to_ball(x) for x in values])


def identity() -> list[flint.arb]:
    """Return the entries of the identity matrix of three rows."""
    return [flint.arb(int(i == j)) for i in range(3) for j in range(3)]


def vector(value: ArrayLike, name: str, n: int) -> tuple[float, ...]:
    """Return ``n`` finite numbers as floats; ValueError for any other value."""
    array = real_array(value, name)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be {n} finite numbers, got {value!r}")
    return tuple(array.tolist())


def number(value: Any, name: str) -> float:
    """Return a finite number as a float; ValueError for any other value."""
    array = real_array(value, name)
    if array.shape != () or not math.isfinite(array.item()):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return float(array.item())


def moments(value: ArrayLike) -> tuple[float, ...]:
    """Return three principal moments of inertia; ValueError if they violate the inequalities."""
    three = vector(value, "inertia", 3)
    if min(three) <= 0.0 or 2.0 * max(three) > sum(three) * (1.0 + 1e-12):
        raise ValueError(
            f"inertia must be positive, none larger than the sum of the others, got {value!r}"
        )
    return three
