"""The choice of steps of `cg.solve_ivp`, for diffrax."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from numpy.typing import ArrayLike

from cg.frames import Frame
from cg.jax.entire import JaxArray
from cg.jax.frames import rules_of
from cg.jax.rules import real_dtype
from cg.jax.term import rules_in
from cg.support.shared_numbers import STEP_CONTROL

_NUMBERS = SimpleNamespace(**STEP_CONTROL)
_MAX_FAILURES = 40  # steps in succession that aren't finite; at time zero no step is too small


def controller(
    frame: Frame, rtol: float, atol: ArrayLike, *, max_step: float | None = None
) -> FrameController:
    """Return the choice of steps of `cg.solve_ivp`, for ``diffrax.diffeqsolve``.

    Errors are measured in coordinates, and so are tolerances: they mean what they mean in
    `cg.solve_ivp`, and with ``dt0=None`` the first step is the same. ``diffrax.PIDController``
    compares entries of points instead, and begins with a step of 0.01. Where steps must not cross
    some times, pass the controller to ``diffrax.ClipStepSizeController``.

    Parameters
    ----------
    frame
        The frame of the term.
    rtol, atol
        Relative and absolute tolerance of the error in a step. ``atol`` is one number, or one
        for each coordinate, shape ``(frame.dim,)``; on frames without `exp_coordinates` one for
        each entry of a point.
    max_step
        Largest size of a step, in the unit of time.

    Warns
    -----
    UserWarning
        If the tolerances together are less than four spacings of floats of JAX at 1, as 1e-8 is
        without ``jax_enable_x64``.

    Notes
    -----
    Derivatives are those of the steps that are taken, with their sizes held fixed. The default
    adjoint of diffrax repeats steps; ``diffrax.RecursiveCheckpointAdjoint(checkpoints=n)`` with n
    as large as ``max_steps`` repeats none and takes less time, but it keeps n points.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> steps = cg.jax.controller(cg.frames.SO3(), rtol=1e-5, atol=1e-6)
    """
    rules = rules_of(frame)
    shape = (frame.dim,) if rules.log is not None else frame.point_shape
    given = f"got rtol = {rtol!r}, atol = {atol!r}"
    try:
        relative, absolute = jnp.asarray(rtol, float), jnp.asarray(atol, float)
    except (TypeError, ValueError):
        raise ValueError(f"rtol and atol must be numbers, {given}") from None
    if relative.shape != ():
        raise ValueError(f"rtol must be a number, got shape {relative.shape}")
    if absolute.shape not in ((), shape):
        raise ValueError(f"atol must be a number or have shape {shape}, got {absolute.shape}")
    least = 4.0 * jnp.finfo(relative.dtype).eps
    traced = isinstance(relative + absolute, jax.core.Tracer)  # whose values aren't known yet
    if not traced and not (
        relative >= 0.0 and (absolute >= 0.0).all() and (relative + absolute > 0.0).all()
    ):
        raise ValueError(f"rtol and atol must not be negative, nor both be zero, {given}")
    if not traced and relative + absolute.max() < least:
        warnings.warn(
            f"rtol = {rtol!r} with atol = {atol!r} is too small to be attained in "
            f"{relative.dtype}, whose spacing is {least / 4.0:.2g}"
            + ("" if jax.config.jax_enable_x64 else "; set jax_enable_x64 for double precision"),
            stacklevel=2,
        )
    if max_step is not None and not max_step > 0.0:
        raise ValueError(f"max_step must be positive, got {max_step!r}")
    return FrameController(relative, absolute, frame, max_step)


def _root_mean_square(errors: JaxArray) -> JaxArray:
    return jnp.sqrt((jnp.abs(errors) ** 2).mean())


class FrameController(diffrax.AbstractAdaptiveStepSizeController):
    """The choice of steps that `controller` makes."""

    rtol: JaxArray
    atol: JaxArray
    frame: Frame = eqx.field(static=True)
    max_step: float | None = None
    norm: Callable[[Any], Any] = _root_mean_square

    def wrap(self, direction: Any) -> FrameController:
        """Return the controller itself: steps backwards in time are chosen in the same way."""
        return self

    def init(
        self,
        terms: Any,
        t0: JaxArray,
        t1: JaxArray,
        y0: JaxArray,
        dt0: Any,
        args: Any,
        func: Callable[..., Any],
        error_order: float | None,
    ) -> tuple[JaxArray, Any]:
        """Return the end of the first step, and the state.

        The state has the last error, whether the step before was rejected, the suspicion of a
        discontinuity, which rejections raise, and the number of failures in succession.
        """
        if error_order is None or (dt0 is None and isinstance(terms, diffrax.MultiTerm)):
            raise ValueError(
                "solver must be a pair for steps to be chosen, and terms without noise; others "
                "take diffrax.ConstantStepSize()"
            )
        frame = rules_in(terms).frame
        if frame != self.frame:
            raise ValueError(f"controller must be one for the frame {frame!r}, got {self.frame!r}")
        none = jnp.zeros((), jnp.int32)
        state = jnp.ones((), real_dtype(y0)), jnp.zeros((), bool), none, none
        start = func(terms, t0, y0, args)
        # XLA removes the evaluation where it is that of the solver.
        t0 = eqx.error_if(
            t0, ~jnp.isfinite(start).all(), "f must return finite numbers at t0 and y0, got others"
        )
        if dt0 is not None:
            return t0 + (dt0 if self.max_step is None else jnp.minimum(dt0, self.max_step)), state
        direction = jnp.sign(terms.contr(t0, t1)).astype(start.dtype)

        def f(t: JaxArray, y: JaxArray) -> JaxArray:
            return direction * func(terms, t, y, args)

        # f may depend on what derivatives are asked for in other ways than by its arguments
        first = self._first(f, (t0, t1), y0, direction * start, error_order)
        first = jax.lax.stop_gradient(first)
        return jnp.where(first < t1 - t0, t0 + first, t1), state

    def _first(
        self,
        f: Callable[[JaxArray, JaxArray], JaxArray],
        times: tuple[JaxArray, JaxArray],
        y0: JaxArray,
        start: JaxArray,
        error_order: float,
    ) -> JaxArray:
        """Return a first step size from the norms of the point, its derivative and curvature."""
        rules, (t0, t1) = rules_of(self.frame), times
        time = jnp.result_type(t0)

        def tangent(v: JaxArray, y: JaxArray) -> JaxArray:
            return v if rules.log is not None else rules.field(v, y)

        scale = self._scale(y0, y0)
        span = jnp.where(jnp.isfinite(t1 - t0), t1 - t0, 1.0)
        least = jnp.minimum(_spacing(t0), span)
        most = span if self.max_step is None else jnp.minimum(span, self.max_step)
        size = self.norm(rules.measured_sizes(y0) / scale)
        slope = self.norm(tangent(start, y0) / scale)
        known = (size > _NUMBERS.negligible) & (slope * span > _NUMBERS.negligible)
        guess = jnp.where(
            known, 0.01 * size / jnp.where(known, slope, 1.0), _NUMBERS.blind_fraction * span
        ).astype(time)
        guess = jnp.maximum(jnp.minimum(guess, most), least)
        h = guess.astype(scale.dtype)
        moved = rules.restore(rules.flow(h * start, y0))
        end = f(t0 + guess, moved)
        change = tangent(end, moved) - tangent(start, y0)
        curvature = self.norm(change / scale) / h
        first = _by_derivatives(size, slope, curvature, error_order).astype(time)
        first = jnp.minimum(jnp.minimum(100.0 * guess, first), most)
        return jnp.where(jnp.isfinite(end).all(), jnp.maximum(first, least), guess)

    def adapt_step_size(
        self,
        t0: JaxArray,
        t1: JaxArray,
        y0: JaxArray,
        y1_candidate: JaxArray,
        args: Any,
        y_error: JaxArray | None,
        error_order: float,
        controller_state: Any,
    ) -> tuple[Any, ...]:
        """Return whether a step is accepted, the ends of the next one, and the state."""
        last_error, after_rejection, suspicion, failures = controller_state
        error = self._error(*jax.lax.stop_gradient((y0, y1_candidate, y_error)))
        long = jnp.abs(t1 - t0) > _NUMBERS.jump_factor * _NUMBERS.smallest_step * _spacing(t0)
        error = jnp.where(
            (suspicion > _NUMBERS.least_suspicion) & long, _NUMBERS.jump_factor * error, error
        )
        keep, finite = error <= 1.0, jnp.isfinite(error)
        factor = _factor(error, last_error, after_rejection, 1.0 / error_order)
        size = (t1 - t0) * factor.astype(jnp.result_type(t1))
        start = jnp.where(keep, t1, t0)
        if self.max_step is not None:
            size = jnp.minimum(size, self.max_step)
        failures = jnp.where(finite, 0, failures + 1).astype(failures.dtype)
        too_small = ~keep & (size < _NUMBERS.smallest_step * _spacing(t0)) | (
            failures >= _MAX_FAILURES
        )
        size = jnp.where(keep, jnp.maximum(size, _NUMBERS.smallest_step * _spacing(start)), size)
        results = diffrax.RESULTS
        result = results.where(finite, results.dt_min_reached, results.nonfinite)
        result = results.where(too_small, result, results.successful)
        last_error = jnp.where(keep, jnp.maximum(error, _NUMBERS.min_last_error), last_error)
        raised = jnp.minimum(suspicion + _NUMBERS.raised_by_rejection, _NUMBERS.max_suspicion)
        suspicion = jnp.where(keep, jnp.maximum(suspicion - 1, 0), raised)
        state = last_error, ~keep, suspicion, failures
        return keep, start, start + size, False, state, result

    def _error(self, y0: JaxArray, y1: JaxArray, difference: JaxArray) -> JaxArray:
        """Return the norm of an error estimate relative to the tolerances, infinite for NaN."""
        rules = rules_of(self.frame)
        if rules.log is not None:
            difference = rules.coefficients(y1, difference)
        error = self.norm(difference / self._scale(y0, y1))
        return jnp.where(jnp.isnan(error), jnp.inf, error)

    def _scale(self, x: JaxArray, y: JaxArray) -> JaxArray:
        """Return the tolerances at the larger of two points, all positive."""
        sizes = rules_of(self.frame).measured_sizes
        largest = jnp.maximum(sizes(x), sizes(y))
        kind = largest.dtype
        scale = self.atol.astype(kind) + self.rtol.astype(kind) * largest
        return jnp.maximum(scale, jnp.finfo(largest.dtype).tiny)


def _spacing(t: JaxArray) -> JaxArray:
    """Return the distance from |t| to the next larger number."""
    size = jnp.abs(jax.lax.stop_gradient(t))  # JAX has no derivatives of nextafter
    return jnp.nextafter(size, jnp.inf) - size


def _by_derivatives(
    size: JaxArray, slope: JaxArray, curvature: JaxArray, error_order: float
) -> JaxArray:
    """Return the step of the first error, infinite where the derivatives say nothing.

    The rate at which the solution changes stands for higher derivatives.
    """
    moving = slope > 0.0
    safe = jnp.where(moving, slope, 1.0)
    rate = jnp.maximum(curvature / safe, jnp.where(size > 0.0, safe / size, 0.0))
    rated = moving & (rate > 0.0)
    unit = jnp.where(rated, rate, 1.0)
    by_rate = (_NUMBERS.first_error * unit / safe) ** (1.0 / error_order) / unit
    by_curvature = jnp.sqrt(_NUMBERS.first_error / jnp.where(curvature > 0.0, curvature, 1.0))
    bent = ~moving & (curvature > 0.0)
    return jnp.where(rated, by_rate, jnp.where(bent, by_curvature, jnp.inf))


def _factor(
    error: JaxArray, last_error: JaxArray, after_rejection: JaxArray, exponent: float
) -> JaxArray:
    """Return the factor of the step size: proportional-integral after accepted steps."""
    positive = jnp.where((error > 0.0) & jnp.isfinite(error), error, 1.0)
    grown = positive**-_NUMBERS.last_power * last_error**_NUMBERS.before_last_power
    accepted = jnp.clip(
        _NUMBERS.safety * grown**exponent, _NUMBERS.smallest_factor, _NUMBERS.largest_factor
    )
    accepted = jnp.where(error > 0.0, accepted, _NUMBERS.largest_factor)
    accepted = jnp.where(after_rejection, jnp.minimum(accepted, 1.0), accepted)
    rejected = jnp.maximum(_NUMBERS.smallest_factor, _NUMBERS.safety * positive**-exponent)
    rejected = jnp.where(jnp.isfinite(error), rejected, _NUMBERS.failure_factor)
    return jnp.where(error <= 1.0, accepted, rejected)
