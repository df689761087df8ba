"""Iterations that solve the stage equations of implicit methods."""

from __future__ import annotations

import math

from cg.support.shared_numbers import StageLimit

STAGE_SOLVERS = {"newton": int(StageLimit.NEWTON), "fixed-point": int(StageLimit.FIXED_POINT)}
"""The iterations for implicit stages, and their limits."""

# Newton's method takes fewer evaluations on the free rigid body at all step sizes: 9 instead of 11
# in a step where fixed-point corrections decrease by a factor of 20, 13 instead of 18 where by 5.
DEFAULT_STAGE_SOLVER = "newton"


class ConvergenceError(RuntimeError):
    """The stage equations of an implicit method were not solved.

    Attributes
    ----------
    reason
        What ended the iteration.
    iterations
        Iterations that were made.
    residual
        Largest residual of the stage equations, in the units of ``f``; NaN if it isn't known.
    t
        Time at which the step starts.
    h
        Signed step size.

    Examples
    --------
    A step so long that its stage equations have no solution:

    >>> import crouch_grossman as cg
    >>> try:
    ...     cg.integrate(
    ...         lambda t, y: 1.0 + y**2, (0, 4), [0.0], frame=cg.frames.Euclidean(1),
    ...         method="ImplicitMidpoint", h=4.0,
    ...     )
    ... except cg.ConvergenceError as error:
    ...     print(f"the step from t = {error.t:g} with h = {error.h:g}")
    the step from t = 0 with h = 4
    """

    def __init__(self, reason: str, iterations: int, residual: float, t: float, h: float) -> None:
        super().__init__(reason, iterations, residual, t, h)
        self.reason = reason
        self.iterations = iterations
        self.residual = residual
        self.t = t
        self.h = h

    def __str__(self) -> str:
        remainder = "" if math.isnan(self.residual) else f" the residual is {self.residual:.3g}"
        return (
            f"the implicit stages did not converge ({self.reason}): after {self.iterations} "
            f"iterations{remainder} in the step of h = {self.h:.6g} from t = {self.t:.17g}; "
            "a smaller step or another stage_solver may help"
        )


def check_stage_solver(kind: object) -> None:
    """Raise ValueError unless ``kind`` is one of `STAGE_SOLVERS`."""
    if not isinstance(kind, str) or kind not in STAGE_SOLVERS:
        names = " or ".join(f'"{name}"' for name in STAGE_SOLVERS)
        raise ValueError(f"stage_solver must be {names}, got {kind!r}")
