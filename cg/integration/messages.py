"""Messages and exceptions of integrations that end early."""

from __future__ import annotations

FINISHED = "The end of t_span was reached."
DERIVATIVES = "derivatives of the solution"
TERMINAL_EVENT = "A terminal event ended the integration."


class StepTooLongError(ArithmeticError):
    """A fixed step is too long for a method on a Lie algebra, or for the events in it.

    Such a method needs coordinates within the radius of dexp⁻¹, which rotations reach after a full
    turn. Events are looked for in up to eight million turns. An adaptive step is tried again with a
    smaller size.

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
    first = min(failures)
    why = failures[first].removesuffix(".")
    return f"Failure of {len(failures)} of {total} trajectories; of y0[{first}]: {why}."
