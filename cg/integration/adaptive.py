"""Steps whose size is chosen by the error estimate of an embedded pair."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Array, Frame, Points
from cg.integration.blocks import is_compiled
from cg.integration.coordinates import coordinate_sizes
from cg.integration.flows import CompiledDifference
from cg.integration.implicit import ConvergenceError, StageOverflowError
from cg.integration.step import Step
from cg.tableau import Tableau

DEFAULT_MAX_STEPS = 10**6
"""The number of steps, rejected ones included, after which an integration is given up."""

_SAFETY = 0.9
_SMALLEST_FACTOR = 0.2
_LARGEST_FACTOR = 5.0
# The factor for steps that failed altogether, so that there is no estimate.
_FAILURE_FACTOR = 0.25
# Exponents of the last error and of the one before it, times the order of the estimate: the PI
# control of Gustafsson.
_LAST = 0.7
_BEFORE_LAST = 0.4
# What the first step's error is meant to be, in tolerances.
_FIRST_ERROR = 0.01
# A size or a slope below this many tolerances tells nothing, and the first guess is this fraction
# of the span.
_NOTHING = 1e-5
_BLIND_FRACTION = 1e-6
# In spacings of floating-point numbers at the time.
_SMALLEST_STEP = 10.0


class StepSizeError(ArithmeticError):
    """The step size that the tolerances call for is below the resolution of time."""


class StepCountError(ArithmeticError):
    """As many steps were taken as are allowed."""


class ErrorNorm:
    r"""The norm in which error estimates are compared with the tolerances.

    The difference between two results is :math:`e` with :math:`e^{e} \hat y = y`, the
    coefficients of the flow from one to the other, where the frame has such coordinates, and
    :math:`y - \hat y` where it hasn't.  The norm is the root mean square of
    :math:`e_i / (\mathrm{atol}_i + \mathrm{rtol}\, s_i)`.  The sizes :math:`s_i` are those of
    `cg.integration.coordinates.coordinate_sizes`: on Euclidean space :math:`|y_i|`, so that the
    norm is that of SciPy there, and 1 for coordinates that have no magnitude of their own, so
    that ``rtol`` is an angle in radians for rotations.  In the ambient space :math:`s` is the
    root mean square of the entries of the point.  Of an ensemble it is the largest of its
    members' norms.

    Parameters
    ----------
    frame
        The frame.
    point
        Any point, or an ensemble of them.
    rtol, atol
        The tolerances; ``atol`` has shape ``(frame.dim,)`` or ``()``, where the frame has no
        logarithm ``point_shape`` or ``()``.

    Raises
    ------
    ValueError
        If ``atol`` has another shape.
    """

    def __init__(self, frame: Frame, point: Points, rtol: float, atol: Array) -> None:
        self.frame = frame
        self.rtol = rtol
        self.atol = atol
        self.in_algebra = frame.exp_coordinates(point, point) is not None
        shape = (frame.dim,) if self.in_algebra else frame.point_shape
        if atol.shape not in ((), shape):
            raise ValueError(f"atol must be a number or have shape {shape}, got {atol.shape}")
        self.axes = tuple(range(-len(shape), 0))
        self.coordinates: Callable[[Points, Points], Array | None] = frame.exp_coordinates
        if is_compiled(frame):
            self.coordinates = CompiledDifference(frame)

    def size(self, y: Points) -> Array:
        """Return what relative errors at a point are relative to, with the axes of `scale`."""
        if self.in_algebra:
            return coordinate_sizes(self.frame, y)
        return rms(y, self.axes, keepdims=True)

    def scale(self, *points: Points) -> Array:
        """Return the tolerances at the largest of some points, all positive."""
        largest = np.max([self.size(y) for y in points], axis=0)
        return np.asarray(np.maximum(self.atol + self.rtol * largest, np.finfo(np.float64).tiny))

    def tangent(self, v: Array, y: Points) -> Points:
        """Return a field's value in the space where errors are measured."""
        return v if self.in_algebra else self.frame.field(v, y)

    def difference(self, y0: Points, y1: Points) -> Points:
        """Return the difference of two points in the space where errors are measured."""
        difference = self.coordinates(y0, y1)
        return y1 - y0 if difference is None else difference

    def error(self, y: Points, other: Points, before: Points) -> float:
        """Return the norm of the difference of two results of a step; at most 1 is accepted."""
        return float(np.max(self.rms(self.difference(other, y) / self.scale(before, y))))

    def rms(self, values: Array) -> Array:
        """Return the root mean square of each member's values, shape ``batch``."""
        return rms(values, self.axes)


class AdaptiveSteps:
    """The accepted steps from an initial point to a final time, all equal for an ensemble.

    Parameters
    ----------
    step
        The step function of a pair.
    norm
        Measures the error.
    t0, stop
        Initial and final time.
    point
        The initial point.
    max_step
        Largest step size, positive.
    first_step
        Size of the first step, positive, or None to choose it from the problem.
    max_steps
        Largest number of steps, rejected ones included.

    Attributes
    ----------
    rejected
        Rejected steps so far.
    """

    def __init__(
        self,
        step: Step,
        norm: ErrorNorm,
        t0: float,
        stop: float,
        point: Points,
        *,
        max_step: float = math.inf,
        first_step: float | None = None,
        max_steps: int = DEFAULT_MAX_STEPS,
    ) -> None:
        self.step = step
        self.norm = norm
        self.t0 = t0
        self.stop = stop
        self.point = point
        self.max_step = max_step
        self.first_step = first_step
        self.max_steps = max_steps
        self.rejected = 0
        self.exponent = error_exponent(step.tableau)

    def __iter__(self) -> Iterator[tuple[float, Points]]:
        """Give time and point at the end of each accepted step.

        Raises
        ------
        StepSizeError
            If the error can't be made small enough by a step that time can resolve.
        StepCountError
            If ``max_steps`` steps don't reach the end.
        """
        t, point = self.t0, self.point
        sign = math.copysign(1.0, self.stop - t)
        if t == self.stop:
            return
        size = self.first_step or self._first_step()
        last_error = 1.0
        after_rejection = False
        attempts = 0
        while t != self.stop:
            if attempts == self.max_steps:
                raise StepCountError(too_many_steps(attempts, t))
            attempts += 1
            size = min(size, self.max_step)
            if size < _SMALLEST_STEP * math.ulp(t):
                raise StepSizeError(too_small_a_step(t))
            end = t + sign * size
            if sign * (end - self.stop) >= 0.0:
                end = self.stop
            taken = abs(end - t)
            error, reached = self._attempt(t, point, end - t)
            if reached is None or not error <= 1.0:
                self.rejected += 1
                after_rejection = True
                factor = _FAILURE_FACTOR
                if reached is not None:
                    factor = max(_SMALLEST_FACTOR, _SAFETY * error**-self.exponent)
                size = taken * factor
                continue
            factor = _LARGEST_FACTOR
            if error > 0.0:
                control = error**-_LAST * last_error**_BEFORE_LAST
                factor = min(factor, max(_SMALLEST_FACTOR, _SAFETY * control**self.exponent))
            if after_rejection:
                factor = min(factor, 1.0)
            # The cut at the end says nothing about the steps before it.
            size = taken * factor
            last_error = max(error, 1e-4)
            after_rejection = False
            t, point = end, reached
            yield t, point

    def _attempt(self, t: float, point: Points, h: float) -> tuple[float, Points | None]:
        """Return error and result of a trial step, or no result if it can't be computed."""
        try:
            reached, other = self.step.pair(t, point, h)
        except (ConvergenceError, StageOverflowError):
            return math.inf, None
        if not (np.isfinite(reached).all() and np.isfinite(other).all()):
            return math.inf, None
        error = self.norm.error(reached, other, point)
        return (error, reached) if math.isfinite(error) else (math.inf, None)

    def _first_step(self) -> float:
        """Return a first step size from two evaluations of f.

        This is the procedure of Hairer, Nørsett, Wanner, "Solving Ordinary Differential
        Equations I", section II.4, with a flow for the explicit Euler step, and with a rate at
        which the solution changes for its derivatives beyond the second, so that the choice
        doesn't depend on the unit of time.
        """
        norm, point = self.norm, self.point
        span = abs(self.stop - self.t0)
        scale = norm.scale(point)
        field = self.step.field(self.t0, point)
        tangent = norm.tangent(field, point)
        sizes = norm.rms(norm.size(point) / scale).ravel().tolist()
        slopes = norm.rms(tangent / scale).ravel().tolist()
        if not all(map(math.isfinite, slopes)):
            raise OverflowError(f"f is too large to choose a step at t = {self.t0!r}, got {field}")
        # An ensemble takes the step of the member that asks for the smallest one.
        guess = min(
            0.01 * size / slope
            if size > _NOTHING and slope * span > _NOTHING
            else _BLIND_FRACTION * span
            for size, slope in zip(sizes, slopes, strict=True)
        )
        smallest = min(math.ulp(self.t0), span)  # not zero, however tiny the span
        guess = max(min(guess, span, self.max_step), smallest)
        h = math.copysign(guess, self.stop - self.t0)
        moved = self.step.compose(((0, 1.0),), field[..., None, :], point, h)
        try:
            next_field = self.step.evaluate(self.t0 + h, moved)
        except StageOverflowError:
            return guess
        change = norm.rms((norm.tangent(next_field, moved) - tangent) / scale).ravel().tolist()
        better = min(
            self._better_first_step(size, slope, difference / guess)
            for size, slope, difference in zip(sizes, slopes, change, strict=True)
        )
        return max(min(100.0 * guess, better, span, self.max_step), smallest)

    def _better_first_step(self, size: float, slope: float, curvature: float) -> float:
        """Return the step whose error is a set fraction of the tolerance, infinite if any."""
        if slope > 0.0:
            rate = max(curvature / slope, slope / size if size > 0.0 else 0.0)
            if rate > 0.0:
                return float((_FIRST_ERROR * rate / slope) ** self.exponent / rate)
        elif curvature > 0.0:
            return math.sqrt(_FIRST_ERROR / curvature)
        return math.inf


def error_exponent(tableau: Tableau) -> float:
    """Return the power of an error that a step is proportional to, by the order of a pair."""
    orders = tableau.order, tableau.embedded_order
    return 1.0 / (min(order for order in orders if order is not None) + 1)


def too_small_a_step(t: float) -> str:
    """Return the message for a step size at ``t`` that is below the resolution of time."""
    smallest = _SMALLEST_STEP * math.ulp(t)
    return f"the step size fell below {smallest:.3g}, the resolution of time, at t = {t:.17g}"


def too_many_steps(max_steps: int, t: float) -> str:
    """Return the message for steps that didn't get beyond ``t``."""
    return f"max_steps = {max_steps} steps, rejected ones included, led only to t = {t:.17g}"


def rms(values: ArrayLike, axes: tuple[int, ...] | None = None, *, keepdims: bool = False) -> Array:
    """Return the root mean square of absolute values over axes, by default over all."""
    squares = np.abs(values) ** 2
    return np.asarray(np.sqrt(np.mean(squares, axis=axes, keepdims=keepdims)))
