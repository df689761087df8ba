"""Quadratic equations with references by Taylor series, and an affine one on rotations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from cg.frames import SO3
from cg.problems.taylor import QuadraticSystem, Reference, Time, reference_solution
from cg.support import flint
from cg.support.arrays import Array, read_only, real_array
from cg.support.frozen import ReadOnly
from cg.support.quads import to_ball


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


def moments(value: ArrayLike) -> tuple[float, ...]:
    """Return three principal moments of inertia; ValueError if they violate the inequalities."""
    three = vector(value, "inertia", 3)
    if min(three) <= 0.0 or 2.0 * max(three) > sum(three) * (1.0 + 1e-12):
        raise ValueError(
            f"inertia must be positive, none larger than the sum of the others, got {value!r}"
        )
    return three


# Four times the coefficients, which have no symmetry
_LINEAR = (
    (3, -1, 2, -2, 1, 4, 1, -3, 2),
    (-1, 4, 1, 3, -2, -1, 2, 2, -4),
    (2, 1, -3, 1, 3, -2, -4, 1, 2),
)


@dataclass(frozen=True)
class StateDependentRotation(ReadOnly, QuadraticProblem):
    r"""A rotation with angular velocity :math:`v(t, y) = v_0 + C\,\mathrm{vec}(y) + t w`.

    The coefficients are affine in the matrix, but none of their derivatives along products of the
    frame's fields vanishes identically, so that every ordered tree contributes to the error of a
    method, and any wrong coefficient reduces the observed order. A right-hand side that depends on
    time alone would test only the abscissae and weights.

    The unknowns of `reference` are the entries of the matrix, row by row, and time.

    Parameters
    ----------
    convention
        The convention of `cg.frames.SO3`.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> from cg.problems.convergence import final_errors, observed_order
    >>> problem = StateDependentRotation()
    >>> exact = cg.integrate(
    ...     problem.f, (0, 1), problem.y0, frame=problem.frame, method="CF6c", h=0.01
    ... ).y[-1]
    >>> h = [1 / 8, 1 / 16, 1 / 32]
    >>> errors = final_errors(
    ...     problem.f, (0, 1), problem.y0, exact, frame=problem.frame, method="CG3", h=h
    ... )
    >>> round(observed_order(h, errors), 1)
    3.0
    """

    convention: Literal["body", "space"] = "body"
    frame: SO3 = field(init=False, repr=False, compare=False)
    y0: Array = field(init=False, repr=False, compare=False)

    constant = np.array([2, -3, 1]) / 4.0
    linear = np.array(_LINEAR) / 4.0
    slope = np.array([-2, 3, 4]) / 4.0

    def __post_init__(self) -> None:
        vars(self).update(frame=SO3(self.convention), y0=read_only(np.eye(3)))

    def f(self, t: float, y: Array) -> Array:
        """Return the coefficients, shape ``(..., 3)``, of points of shape ``(..., 3, 3)``."""
        flat = y.reshape(*y.shape[:-2], 9)
        return np.asarray(self.constant + t * self.slope + flat @ self.linear.T)

    def _initial(self) -> list[flint.arb]:
        return [*map(to_ball, self.y0.ravel()), flint.arb(0)]

    def _derivatives(self, y: Any) -> Any:
        # Unknowns: the entries of the matrix, and time
        point, t = y[:-1], y[-1]
        v = self.linear.astype(object) @ point + self.constant + t * self.slope
        rows = point.reshape(3, 3)
        if self.convention == "body":
            return [*np.cross(rows, v).ravel(), 1.0]
        return [*np.cross(v, rows.T).T.ravel(), 1.0]
