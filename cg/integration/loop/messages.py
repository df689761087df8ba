"""Messages and exceptions of integrations that end early."""

from __future__ import annotations

FINISHED = "The end of t_span was reached."
LEFT_MANIFOLD = (
    "the solution has left the manifold: its relative distance at the end is {distance:.3g}, more "
    "than {tolerance:.3g}; a restore of the frame would keep it there, and cg.frames.check(frame) "
    "tells whether its flows do"
)
LONG_STEPS = (
    "h = {h:.6g} is far too long a step: between the stages of the last step h f changes by more "
    "than the radius of dexp⁻¹, for rotations a full turn; take a smaller h"
)
MANY_REJECTIONS = (
    "{nrejected} steps were rejected beside {steps} accepted ones: if f has kinks or jumps at "
    "known times, name them as breakpoints"
)
MAX_STEPS = "max_steps = {steps} steps, rejected ones included, led only to t = {t:.17g}{reason}"
STEP_TOO_SMALL = "the step size fell below {smallest:.3g}, the resolution of time, at t = {t:.17g}"
FLOW_NOT_FINITE = (
    "the flow of {frame!r} returned NaN or infinity at t = {t:.17g}, however small the step"
)
NO_PROGRESS = "jumps of events follow each other without progress at t = {t:.17g}"
RESTS = (
    "the jump of events[{event}] leaves its function at zero at t = {t:.17g}, and f doesn't move "
    "it off, as where a contact rests: continue from there with f of the contact; if the solution "
    "shall pass, let the jump move it past the zero"
)
ZERO_TOLERANCE = (
    "atol must be positive for coordinates that are zero, got 0 at t = {t:.17g}, y = {point}"
)
MANY_STEPS = "the integration takes many steps, since {reason}"
STIFF = 'the equation is stiff, for which method="RadauIIA5" takes larger steps'
DISCONTINUOUS = (
    "f is discontinuous near the solution: name known times of jumps as breakpoints; where the "
    "solution meets a jump, end it by a terminal event, and continue with f of the other side; "
    "where it would stay on the jump, as in static friction, use a smooth f and method='RadauIIA5'"
)
DERIVATIVES = "derivatives of the solution"
TERMINAL_EVENT = "A terminal event ended the integration."


class StageOverflowError(OverflowError):
    """A stage exceeds the range of floating point, which isn't an error of ``f``."""


class StepTooLongError(ArithmeticError):
    """A step of a method on a Lie algebra reached coordinates beyond the radius of dexp⁻¹.

    Rotations reach it after a full turn. An adaptive step is tried again with a smaller size;
    with fixed steps a smaller ``h`` is needed.

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

    def __init__(self, t: float) -> None:
        super().__init__(
            f"the step from t = {t:.17g} is too long for a method on a Lie algebra: coordinates "
            "of a stage are beyond the radius of dexp⁻¹, for rotations a full turn; take a smaller "
            "h, or a method that needs no brackets"
        )
        self.t = t

    def __reduce__(self) -> tuple[type[StepTooLongError], tuple[float]]:
        return StepTooLongError, (self.t,)


def failed_members(failures: dict[int, str], total: int) -> str:
    """Return the message for members of an ensemble that ended early."""
    first = min(failures)
    why = failures[first].removesuffix(".")
    return f"Failure of {len(failures)} of {total} trajectories; of y0[{first}]: {why}."
