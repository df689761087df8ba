"""A rotation whose angular velocity depends on where it is: a test of order that sees all trees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from flint import arb

from cg.frames import SO3
from cg.frames.arrays import Array
from cg.problems.taylor import QuadraticSystem, Reference, Term, Time, reference_solution

# Quarters of the coefficients: no symmetry relates any two of them.
_CONSTANT = (2, -3, 1)
_LINEAR = (
    (3, -1, 2, -2, 1, 4, 1, -3, 2),
    (-1, 4, 1, 3, -2, -1, 2, 2, -4),
    (2, 1, -3, 1, 3, -2, -4, 1, 2),
)
_TIME = (-2, 3, 4)
_UNIT = 4.0


@dataclass(frozen=True)
class StateDependentRotation:
    r"""A rotation with angular velocity :math:`v(t, y) = v_0 + C\,\mathrm{vec}(y) + t w`.

    The coefficients are affine in the matrix, yet no derivative of them along products of the
    frame's fields vanishes identically, so that every ordered tree contributes to the error of a
    method: misplaced coefficients, reversed rows of stages among them, show in the order.
    A right side that depends on time alone would see the abscissae and weights only.

    Parameters
    ----------
    convention
        That of `cg.frames.SO3`.

    Raises
    ------
    ValueError
        If there is no such convention.

    Examples
    --------
    >>> import cg
    >>> from cg.analysis.convergence import final_errors, observed_order
    >>> problem = StateDependentRotation()
    >>> exact = cg.integrate(
    ...     problem.f, (0, 1), problem.y0, frame=problem.frame, method="CF6c", h=0.01
    ... ).y[-1]
    >>> h = [1 / 8, 1 / 16, 1 / 32]
    >>> errors = final_errors(
    ...     problem.f, (0, 1), problem.y0, exact, frame=problem.frame, method="CG3", h=h
    ... )
    >>> round(observed_order(h, errors).order, 1)
    3.0
    """

    convention: Literal["body", "space"] = "body"

    def __post_init__(self) -> None:
        SO3(self.convention)

    @property
    def frame(self) -> SO3:
        """The frame of the convention."""
        return SO3(self.convention)

    @property
    def y0(self) -> Array:
        """The identity, shape ``(3, 3)``."""
        return np.eye(3)

    def f(self, t: float, y: Array) -> Array:
        """Return the angular velocity, shape ``(3,)``, at time ``t`` and rotation ``y``."""
        linear = np.array(_LINEAR) @ y.reshape(9)
        return np.asarray((np.array(_CONSTANT) + linear + t * np.array(_TIME)) / _UNIT)

    def reference(self, times: Sequence[Time], *, bits: int = 256) -> Reference:
        """Return the solution at given times in extended precision.

        The ten unknowns are the entries of the matrix, row by row, and time itself.

        Raises
        ------
        ValueError
            If a time isn't a finite number.
        """
        return reference_solution(self._system, times, bits=bits)

    def _system(self) -> QuadraticSystem:
        unit = 1 / arb(_UNIT)
        velocity: list[list[Term]] = []
        for constant, linear, slope in zip(_CONSTANT, _LINEAR, _TIME, strict=True):
            terms: list[Term] = [(unit * constant, ()), (unit * slope, (9,))]
            terms += [(unit * c, (j,)) for j, c in enumerate(linear)]
            velocity.append(terms)
        equations: list[tuple[Term, ...]] = [()] * 9
        for row in range(3):
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                # Rows of y turn as x cross v in body axes, columns as v cross x in space axes.
                if self.convention == "body":
                    x, sign = [3 * row + n for n in range(3)], 1
                else:
                    x, sign = [3 * n + row for n in range(3)], -1
                equations[x[i]] = tuple(
                    [(sign * c, (x[j], *rest)) for c, rest in velocity[k]]
                    + [(-sign * c, (x[k], *rest)) for c, rest in velocity[j]]
                )
        clock: tuple[Term, ...] = ((arb(1), ()),)
        initial = tuple(arb(int(i == j)) for i in range(3) for j in range(3))
        return QuadraticSystem((*equations, clock), (*initial, arb(0)))
