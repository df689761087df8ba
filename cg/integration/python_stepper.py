"""Steps in Python: of implicit methods, and on frames whose flows aren't compiled."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from cg.frames.arrays import Array, Points
from cg.integration.implicit import ConvergenceError
from cg.integration.messages import flow_not_finite, too_many_steps, too_small_a_step
from cg.integration.python_rhs import StageOverflowError, StepTooLongError
from cg.integration.step import Step
from cg.integration.stepper import AdaptiveSchedule, Block, Stepper, error_exponent
from cg.integration.time_grid import TimeGrid

__all__ = ["PythonStepper"]


class PythonStepper(Stepper):
    """Steps one at a time.

    Parameters
    ----------
    step
        The step function.
    point
        The initial point or points.
    schedule
        Which steps to take.
    slopes
        Whether blocks have slopes.
    every
        How many steps of a grid there are between those that blocks have.
    """

    def __init__(
        self,
        step: Step,
        point: Points,
        schedule: TimeGrid | AdaptiveSchedule,
        *,
        slopes: bool = False,
        every: int = 1,
    ) -> None:
        import cg._external as core

        super().__init__(step.frame, step.method, step.batch)
        self.counts = step.counts
        self.step = step
        self.point = point
        self.schedule = schedule
        self.slopes = slopes
        self.every = every
        self._core = core
        self._last = schedule.start, point

    def blocks(self) -> Iterator[Block]:
        """Give the steps, each as a block.

        Raises
        ------
        OverflowError
            If the solution exceeds the range of floating point in equal steps.
        ConvergenceError
            If implicit stages can't be found in them.
        StepTooLongError
            If one is too long for dexp⁻¹.
        """
        if isinstance(self.schedule, TimeGrid):
            steps = self._equal_steps(self.schedule)
        else:
            steps = self._adaptive_steps(self.schedule)
        for t, point in steps:
            self.counts.steps += 1
            if self.counts.steps % self.every and t != self.schedule.stop:
                continue
            before, self._last = self._last, (t, point)
            slope = self.step.field(*before)[None] if self.slopes else None
            yield Block(np.array([before[0], t]), np.stack([before[1], point]), slope)

    def last_slope(self) -> Array:
        """Return the coefficients where the last step led."""
        return self.step.field(*self._last)

    def evaluate(self, t: Array, y: Points) -> Array:
        """Return coefficients at times ``(n,)`` and points ``(n, *batch, *point_shape)``."""
        pairs = zip(t.tolist(), y, strict=True)
        return np.array([self.step.evaluate(time, point) for time, point in pairs])

    def end_member(self, index: tuple[int, ...]) -> None:
        """Leave a member where it is."""
        self.step.end_member(index)

    def _equal_steps(self, grid: TimeGrid) -> Iterator[tuple[float, Points]]:
        # Full steps take h itself, not differences of rounded times, so that all are equal.
        point = self.point
        for k in range(1, grid.steps + 1):
            size = grid.last if k == grid.steps else grid.h
            end = grid.stop if k == grid.steps else grid.start + k * grid.h
            point = self.step(grid.start + (k - 1) * grid.h, point, size)
            if not np.isfinite(point).all():
                raise OverflowError(f"the solution is no longer finite at t = {end:.17g}")
            yield end, point

    def _adaptive_steps(self, schedule: AdaptiveSchedule) -> Iterator[tuple[float, Points]]:
        t, stop, point = schedule.start, schedule.stop, self.point
        if t == stop:
            return
        exponent = error_exponent(self.method)
        size = schedule.first_step or self._first_size(schedule)
        last_error, after_rejection, end = 1.0, False, t
        for _ in range(schedule.max_steps):
            size = self._core.tried_size(size, t, stop, schedule.max_step, after_rejection)
            if size < 0.0:
                self.trouble = self._why_no_step(t, point, end - t)
                return
            sign = math.copysign(1.0, stop - t)
            end = t + sign * size
            if sign * (end - stop) >= 0.0:
                end = stop
            error, reached = self._attempt(schedule, t, point, end - t)
            accepted, size, last_error = self._core.control_step(
                abs(end - t), error, exponent, last_error, after_rejection
            )
            after_rejection = not accepted
            if not accepted:
                self.counts.rejected += 1
                continue
            assert reached is not None
            t, point = end, reached
            yield t, point
            if t == stop:
                return
        self.trouble = too_many_steps(schedule.max_steps, t)

    def _why_no_step(self, t: float, point: Points, h: float) -> str:
        """Return what to say where no step is small enough, ``h`` having been the last one."""
        field = self.step.field(t, point)[..., None, :]
        if np.isfinite(self.step.compose(((0, 1.0),), field, point, h)).all():
            return too_small_a_step(t, self._core.smallest_size(t))
        return flow_not_finite(self.step.frame, t)

    def _attempt(
        self, schedule: AdaptiveSchedule, t: float, point: Points, h: float
    ) -> tuple[float, Points | None]:
        """Return error and result of a trial step; a huge error if it can't be computed."""
        huge = float(np.finfo(np.float64).max)
        try:
            reached, error = self.step.trial(t, point, h, schedule.norm)
        except (ConvergenceError, StageOverflowError, StepTooLongError):
            return huge, None
        return (error, reached) if reached is not None else (huge, None)

    def _first_size(self, schedule: AdaptiveSchedule) -> float:
        """Return a first step size from two evaluations of f; see ``fortran/controller.f90.in``."""
        norm, point, t = schedule.norm, self.point, schedule.start
        span = abs(schedule.stop - t)
        scale = norm.scale(point)
        field = self.step.field(t, point)
        tangent = norm.tangent(field, point)
        sizes = norm.rms(norm.size(point) / scale).ravel().tolist()
        slopes = norm.rms(tangent / scale).ravel().tolist()
        if not all(map(math.isfinite, slopes)):
            raise OverflowError(f"f is too large to choose a step at t = {t:.17g}, got {field}")
        # An ensemble takes the step of the member that asks for the smallest one.
        guess: float = min(
            self._core.first_guess(size, slope, span)
            for size, slope in zip(sizes, slopes, strict=True)
        )
        smallest = min(math.ulp(t), span)  # not zero, however tiny the span
        guess = max(min(guess, span, schedule.max_step), smallest)
        h = math.copysign(guess, schedule.stop - t)
        moved = self.step.compose(((0, 1.0),), field[..., None, :], point, h)
        try:
            next_field = self.step.evaluate(t + h, moved)
        except StageOverflowError:
            return guess
        change = norm.rms((norm.tangent(next_field, moved) - tangent) / scale).ravel().tolist()
        exponent = error_exponent(self.method)
        better: float = min(
            self._core.first_size(size, slope, difference / guess, exponent)
            for size, slope, difference in zip(sizes, slopes, change, strict=True)
        )
        return max(min(100.0 * guess, better, span, schedule.max_step), smallest)
