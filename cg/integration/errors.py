"""Exceptions and messages of integrations that end early."""

from __future__ import annotations

import math

FINISHED = "The end of t_span was reached."
TERMINAL_EVENT = "A terminal event ended the integration."


class ConvergenceError(RuntimeError):
    """The stage equations of an implicit method were not solved.

    Attributes
    ----------
    reason
        The reason for which the iteration ended.
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
            "a smaller step may help, or another stage_solver where the method has one"
        )


class StepTooLongError(ArithmeticError):
    """A fixed step is too long for a method on a Lie algebra, or for the events in it.

    Such a method needs coordinates within the radius of dexp⁻¹, which rotations reach after a full
    turn. Events are looked for in up to eight million turns. An adaptive step is tried again with a
    smaller size.

    Attributes
    ----------
    t, for_events
        Time at which the step starts, and whether it is too long for events, not for the method.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> try:
    ...     cg.integrate(
    ...         lambda t, y: [0.0, 9.0, 9.0 * y[0, 0]], (0, 2), np.eye(3), frame=cg.frames.SO3(),
    ...         method="RKMK4", h=1.0,
    ...     )
    ... except cg.StepTooLongError as error:
    ...     print(str(error)[:46])
    the step from t = 0 is too long for a method o
    """

    def __init__(self, t: float, for_events: bool = False) -> None:
        reason = (
            "its events, as it rotates by more than eight million turns; take a smaller h"
            if for_events
            else "a method on a Lie algebra: coordinates of a stage are beyond the radius of "
            "dexp⁻¹, for rotations a full turn; take a smaller h, or a method that needs no "
            "brackets"
        )
        super().__init__(f"the step from t = {t:.17g} is too long for {reason}")
        self.t, self.for_events = t, for_events

    def __reduce__(self) -> tuple[type[StepTooLongError], tuple[float, bool]]:
        return StepTooLongError, (self.t, self.for_events)


def failed_members(failures: dict[int, str], total: int) -> str:
    """Return the message for members of an ensemble that ended early."""
    member = min(failures)
    reason = failures[member].removesuffix(".")
    return f"Failure of {len(failures)} of {total} trajectories; of y0[{member}]: {reason}."
