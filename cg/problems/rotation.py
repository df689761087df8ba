"""A rotation with state-dependent angular velocity, a test of all order conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cg.frames import SO3
from cg.frames.arrays import Array
from cg.problems.quadratic import QuadraticProblem, identity
from cg.support import flint

# Four times the coefficients, which have no symmetry
_CONSTANT = (2, -3, 1)
_LINEAR = (
    (3, -1, 2, -2, 1, 4, 1, -3, 2),
    (-1, 4, 1, 3, -2, -1, 2, 2, -4),
    (2, 1, -3, 1, 3, -2, -4, 1, 2),
)
_TIME = (-2, 3, 4)
_UNIT = 4.0


@dataclass(frozen=True)
class StateDependentRotation(QuadraticProblem):
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

    Raises
    ------
    ValueError
        If the convention is neither "body" nor "space".

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> from cg.analysis.convergence import final_errors, observed_order
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

    def __post_init__(self) -> None:
        SO3(self.convention)

    @property
    def frame(self) -> SO3:
        """``SO3(convention)``."""
        return SO3(self.convention)

    @property
    def y0(self) -> Array:
        """The identity, shape ``(3, 3)``."""
        return np.eye(3)

    def f(self, t: float, y: Array) -> Array:
        """Return the angular velocity, shape ``(3,)``, at time ``t`` and rotation ``y``."""
        linear = np.array(_LINEAR) @ y.reshape(9)
        return np.asarray((np.array(_CONSTANT) + linear + t * np.array(_TIME)) / _UNIT)

    def _initial(self) -> list[flint.arb]:
        return [*identity(), flint.arb(0)]

    def _derivatives(self, y: Any) -> Any:
        # Unknowns: the matrix, and time
        matrix, t = y[:9].reshape(3, 3), y[9]
        v = (np.array(_CONSTANT) + np.array(_LINEAR) @ y[:9] + t * np.array(_TIME)) * (1 / _UNIT)
        body = self.convention == "body"
        change = np.cross(matrix, v) if body else np.cross(v, matrix.T).T
        return [*change.ravel(), 1.0]
