"""A rotation with state-dependent angular velocity, a test of all order conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cg.frames import SO3
from cg.problems.affine import AffineProblem

# Four times the coefficients, which have no symmetry
_LINEAR = (
    (3, -1, 2, -2, 1, 4, 1, -3, 2),
    (-1, 4, 1, 3, -2, -1, 2, 2, -4),
    (2, 1, -3, 1, 3, -2, -4, 1, 2),
)


@dataclass(frozen=True)
class StateDependentRotation(AffineProblem):
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

    constant = np.array([2, -3, 1]) / 4.0
    linear = np.array(_LINEAR) / 4.0
    slope = np.array([-2, 3, 4]) / 4.0

    def __post_init__(self) -> None:
        identity = np.eye(3)
        identity.flags.writeable = False
        vars(self).update(frame=SO3(self.convention), y0=identity)
