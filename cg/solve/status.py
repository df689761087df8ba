"""Why a Levenberg–Marquardt solver stopped."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """MINPACK's ``info``, by the names that the compiled solver has for it.

    References
    ----------
    .. [1] J. J. Moré, B. S. Garbow, K. E. Hillstrom, User Guide for MINPACK-1,
       Argonne National Laboratory report ANL-80-74 (1980).
    """

    STOPPED_BY_USER = -1
    IMPROPER_INPUT = 0
    SMALL_REDUCTION = 1
    SMALL_STEP = 2
    SMALL_REDUCTION_AND_STEP = 3
    SMALL_GRADIENT = 4
    TOO_MANY_EVALUATIONS = 5
    FTOL_TOO_SMALL = 6
    XTOL_TOO_SMALL = 7
    GTOL_TOO_SMALL = 8

    @property
    def converged(self) -> bool:
        """Whether one of the requested convergence tests was met."""
        return Status.SMALL_REDUCTION <= self <= Status.SMALL_GRADIENT

    @property
    def message(self) -> str:
        """The status as a sentence."""
        return _MESSAGES[self]


_MESSAGES = {
    Status.STOPPED_BY_USER: "The function stopped the solver.",
    Status.IMPROPER_INPUT: "The solver refused its arguments.",
    Status.SMALL_REDUCTION: (
        "The actual and the predicted relative reduction of the sum of squares are at most ftol."
    ),
    Status.SMALL_STEP: "The relative change between two iterates is at most xtol.",
    Status.SMALL_REDUCTION_AND_STEP: (
        "The relative reductions of the sum of squares are at most ftol, "
        "and the relative change between two iterates is at most xtol."
    ),
    Status.SMALL_GRADIENT: (
        "The cosines between the residual and the columns of the Jacobian are at most gtol."
    ),
    Status.TOO_MANY_EVALUATIONS: "The number of evaluations has reached maxfev.",
    Status.FTOL_TOO_SMALL: "ftol is too small: the sum of squares can't be reduced further.",
    Status.XTOL_TOO_SMALL: "xtol is too small: the iterate can't be improved further.",
    Status.GTOL_TOO_SMALL: (
        "gtol is too small: the residual is orthogonal to the columns of the Jacobian "
        "to machine precision."
    ),
}
