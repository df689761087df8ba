"""Right-hand sides that are functions in Python: their results are checked where they come in."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points, real_array
from cg.frames.base import Frame
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_group import MatrixGroup

__all__ = ["Coefficients", "PythonRhs", "StageOverflowError", "StepTooLongError"]

Coefficients = Callable[..., ArrayLike]


class StageOverflowError(OverflowError):
    """A stage is beyond the range of floating point; no error of f itself."""


class StepTooLongError(ArithmeticError):
    """A step of a method on a Lie algebra reached coordinates beyond the radius of dexp⁻¹.

    Rotations reach it after a full turn.  A chosen step is tried again with a smaller size; a
    fixed one needs a smaller ``h``.

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


class PythonRhs:
    """A right-hand side ``f(t, y, *args)`` for one point or an ensemble.

    Compiled code calls it through a function in C whose data are `context`, which must be kept
    alive meanwhile.

    Parameters
    ----------
    f
        Returns the coefficients, shape ``(*batch, frame.dim)``; it is given a read-only ``y`` of
        shape ``(*batch, *frame.point_shape)``.
    frame
        Where the points are.
    batch
        Leading axes of an ensemble.
    args
        Further arguments.

    Attributes
    ----------
    context
        What the function in C needs.
    ended
        Which members of the ensemble an event has ended, shape ``batch``.  Their coefficients
        are zero whatever ``f`` returns for them.
    """

    def __init__(
        self,
        f: Coefficients,
        frame: Frame,
        batch: tuple[int, ...] = (),
        args: tuple[Any, ...] = (),
    ) -> None:
        self.f = f
        self.frame = frame
        self.batch = batch
        self.args = args
        self.shape = (*batch, frame.dim)
        self.ended = np.zeros(batch, dtype=np.bool_)
        self.context = (
            f,
            args,
            (*batch, *frame.point_shape),
            frame.dtype.num,
            self.shape,
            self.check,
            [None],
            self.ended,
        )

    def __call__(self, t: float, point: Points) -> Array:
        """Return f(t, point) after checking it, as an array of its own."""
        visible = point.view()
        visible.flags.writeable = False
        return self.check(self.f(t, visible, *self.args), t, visible, finite_only=True)

    def check(self, value: Any, t: float, y: Points, finite_only: bool = False) -> Array:
        """Return what ``f`` returned as an array, shape ``(*batch, dim)``.

        Parameters
        ----------
        value
            What it returned.
        t, y
            What it was given.
        finite_only
            Whether to refuse what isn't finite at a point that isn't either.  Compiled code sees
            that for itself.

        Raises
        ------
        ValueError
            If it has another shape, or isn't finite numbers although ``y`` is.
        StageOverflowError
            If neither it nor ``y`` is finite.
        """
        try:
            # This copies, since f may return the same buffer each time.
            coefficients = real_array(value, "f")
        except ValueError as error:
            shape = self.shape
            wanted = f"an array of shape {shape}" if self.batch else f"{shape[0]} real numbers"
            raise ValueError(f"f must return {wanted}, got {value!r} at t = {t:.17g}") from error
        if coefficients.shape != self.shape:
            got = "None" if value is None else f"shape {coefficients.shape}"
            raise ValueError(
                f"f must return an array of shape {self.shape}, got {got} at t = {t:.17g}"
                f"{self._hint(coefficients.shape[len(self.batch) :])}"
            )
        if self.batch:
            coefficients[self.ended] = 0.0
        # Sums are finite only if all their terms are, and take a fraction of the time.
        if not math.isfinite(coefficients.sum()) and not np.isfinite(coefficients).all():
            if np.isfinite(y).all():
                raise ValueError(
                    f"f must return finite numbers, got {coefficients} at t = {t:.17g}"
                )
            if finite_only:
                raise StageOverflowError(f"a stage is no longer finite at t = {t:.17g}")
        return coefficients

    def _hint(self, shape: tuple[int, ...]) -> str:
        """Return what to do if ``f`` returned a matrix of the Lie algebra, or a derivative."""
        group = self.frame.group if isinstance(self.frame, HomogeneousSpace) else self.frame
        if not isinstance(group, MatrixGroup) or shape != group.point_shape:
            if shape != self.frame.point_shape:
                return ""
            return "; f returns coefficients of the frame's fields, not the derivative of y"
        name = "frame.coefficients" if group is self.frame else "frame.group.coefficients"
        return f"; {name}(matrix) are those of a matrix in the Lie algebra"
