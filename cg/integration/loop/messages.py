"""Messages and exceptions of integrations that end early."""

from __future__ import annotations

import math

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.support.shared_numbers import Stop

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

    Rotations reach it after a full turn.  An adaptive step is tried again with a smaller size;
    with fixed steps a smaller ``h`` is needed.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
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


def failure(
    stop: Stop, flag: int, t: float, slope: Array | None = None, name: str = "f"
) -> Exception:
    """Return the exception for an integration that failed at time ``t``.

    ``flag`` is what the compiled function ``name`` returned, ``slope`` are the initial coefficients
    where they are the reason.
    """
    where = f"at t = {t:.17g}"
    error: Exception = MemoryError("there is not enough memory for the stages of one step")
    match stop:
        case Stop.STOPPED_BY_FIELD:
            error = RuntimeError(f"{name} returned the error code {flag} {where}")
        case Stop.FIELD_NOT_FINITE if name == DERIVATIVES:
            error = OverflowError(f"{name} exceed the range of floating point {where}")
        case Stop.FIELD_NOT_FINITE:
            error = ValueError(f"{name} must return finite numbers, and all of them, {where}")
        case Stop.STAGE_NOT_FINITE:
            error = StageOverflowError(f"a stage is no longer finite {where}")
        case Stop.STEP_TOO_LONG:
            error = StepTooLongError(t)
        case Stop.SOLUTION_NOT_FINITE:
            error = OverflowError(f"the solution is no longer finite {where}")
        case Stop.SLOPE_NOT_FINITE:
            error = OverflowError(f"f is too large to choose a step {where}, got {slope}")
    return error


def zero_tolerance(t: float, point: Points) -> str:
    """Return the message for a coordinate of zero that changes without any tolerance."""
    return (
        f"atol must be positive for coordinates that are zero, got 0 at t = {t:.17g}, y = {point}"
    )


def too_small_a_step(t: float) -> str:
    """Return the message for a step size at ``t`` below the resolution of time."""
    smallest = 10.0 * math.ulp(t)
    return f"the step size fell below {smallest:.3g}, the resolution of time, at t = {t:.17g}"


def flow_not_finite(frame: Frame, t: float) -> str:
    """Return the message for a flow that returns NaN even for the smallest step from ``t``."""
    return f"the flow of {frame!r} returned NaN or infinity at t = {t:.17g}, however small the step"


def no_progress(t: float) -> str:
    """Return the message for jumps without progress in time."""
    return f"jumps of events follow each other without progress at t = {t:.17g}"


def rests(event: int, t: float) -> str:
    """Return the message for a jump after which the solution would stay on its event."""
    return (
        f"the jump of events[{event}] leaves its function at zero at t = {t:.17g}, and f doesn't "
        "move it off, as where a contact rests: continue from there with f of the contact; if the "
        "solution shall pass, let the jump move it past the zero"
    )


def too_many_steps(max_steps: int, t: float, rejected: int, reason: str | None) -> str:
    """Return the message for ``max_steps`` steps that reached only ``t``, with a known reason."""
    text = f"max_steps = {max_steps} steps, rejected ones included, led only to t = {t:.17g}"
    if 2 * rejected > max_steps // 10:
        text += f"; {rejected} of them were rejected"
    return text if reason is None else f"{text}; {reason}"


def failed_members(failures: dict[int, str], total: int) -> str:
    """Return the message for members of an ensemble that ended early."""
    first = min(failures)
    why = failures[first].removesuffix(".")
    return f"Failure of {len(failures)} of {total} trajectories; of y0[{first}]: {why}."
