"""Messages and exceptions of integrations that end early."""

from __future__ import annotations

FINISHED = "The end of t_span was reached."
DERIVATIVES = "derivatives of the solution"
TERMINAL_EVENT = "A terminal event ended the integration."


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
