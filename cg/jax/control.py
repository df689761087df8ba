"""The choice of steps of `cg.solve_ivp`, for diffrax, from error estimates at the ends of steps.

They are made of differences of results and of sums of stages in the ways of `EstimateForm`, with
norms where both tolerances of `controller` are 1. ``fortran/steps/error_estimate.f90`` computes the
same, but at large angles.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from numpy.typing import ArrayLike

from cg.frames import Frame
from cg.jax.frames import rules_of, turning
from cg.jax.rules import JaxArray, Rules, real_dtype
from cg.jax.stages import Stages, Start
from cg.jax.term import rules_in
from cg.support.checks import check_real, warn_user
from cg.support.shared_numbers import ERROR_ESTIMATE, STEP_CONTROL, EstimateForm
from cg.tables import MethodTable

_CONTROL, _ESTIMATE = SimpleNamespace(**STEP_CONTROL), SimpleNamespace(**ERROR_ESTIMATE)
_MAX_FAILURES = 40  # failed steps in succession: at time zero no size is below the least step


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
    tolerances = f"got rtol = {rtol!r}, atol = {atol!r}"
    try:
        relative, absolute = jnp.asarray(rtol, float), jnp.asarray(atol, float)
    except (TypeError, ValueError):
        raise ValueError(f"rtol and atol must be numbers, {tolerances}") from None
    if relative.shape != ():
        raise ValueError(f"rtol must be a number, got shape {relative.shape}")
    if absolute.shape not in ((), shape):
        raise ValueError(f"atol must be a number or have shape {shape}, got {absolute.shape}")
    least = 4.0 * jnp.finfo(relative.dtype).eps
    traced = isinstance(relative + absolute, jax.core.Tracer)  # tracers have no values yet
    if not traced and not (
        relative >= 0.0
        and (absolute >= 0.0).all()
        and ((relative + absolute > 0.0) & (relative + absolute < jnp.inf)).all()
    ):
        raise ValueError(
            f"rtol and atol must be finite, not negative, and not both zero, {tolerances}"
        )
    if not traced and relative + absolute.max() < least:
        warn_user(
            f"rtol = {rtol!r} with atol = {atol!r} is too small to be attained in "
            f"{relative.dtype}, whose spacing is {least / 4.0:.2g}"
            + ("" if jax.config.jax_enable_x64 else "; set jax_enable_x64 for double precision")
        )
    if max_step is not None:
        max_step = check_real("max_step", max_step, positive=True, infinite=True)
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
        self, terms: Any, t0: JaxArray, t1: JaxArray, y0: JaxArray, dt0: Any, args: Any,
        func: Callable[..., Any], error_order: float | None,
    ) -> tuple[JaxArray, Any]:  # fmt: skip
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

        # f may depend on quantities with derivatives in other ways than by its arguments
        size = self._first_step(f, (t0, t1), y0, direction * start, error_order)
        size = jax.lax.stop_gradient(size)
        return jnp.where(size < t1 - t0, t0 + size, t1), state

    def _first_step(
        self, f: Callable[[JaxArray, JaxArray], JaxArray], times: tuple[JaxArray, JaxArray],
        y0: JaxArray, start: JaxArray, error_order: float,
    ) -> JaxArray:  # fmt: skip
        """Return a first step size from the norms of the point, its derivative and curvature."""
        rules, (t0, t1) = rules_of(self.frame), times
        time = jnp.result_type(t0)

        def tangent(v: JaxArray, y: JaxArray) -> JaxArray:
            return v if rules.log is not None else rules.field(v, y)

        scale = self._scale(y0, y0)
        span = jnp.where(jnp.isfinite(t1 - t0), t1 - t0, 1.0)
        lower = jnp.minimum(_spacing(t0), span)
        upper = span if self.max_step is None else jnp.minimum(span, self.max_step)
        size = self.norm(rules.measured_sizes(y0) / scale)
        slope = self.norm(tangent(start, y0) / scale)
        informative = (size > _CONTROL.negligible) & (slope * span > _CONTROL.negligible)
        guess = jnp.where(
            informative,
            _CONTROL.guess_fraction * size / jnp.where(informative, slope, 1.0),
            _CONTROL.blind_fraction * span,
        ).astype(time)
        guess = jnp.maximum(jnp.minimum(guess, upper), lower)
        h = guess.astype(scale.dtype)
        moved = rules.restore(rules.flow(h * start, y0))
        end = f(t0 + guess, moved)
        change = tangent(end, moved) - tangent(start, y0)
        curvature = self.norm(change / scale) / h
        chosen = _step_by_derivatives(size, slope, curvature, error_order).astype(time)
        chosen = jnp.minimum(jnp.minimum(_CONTROL.max_growth * guess, chosen), upper)
        return jnp.where(jnp.isfinite(end).all(), jnp.maximum(chosen, lower), guess)

    def adapt_step_size(
        self, t0: JaxArray, t1: JaxArray, y0: JaxArray, y1_candidate: JaxArray, args: Any,
        y_error: JaxArray | None, error_order: float, controller_state: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """Return whether a step is accepted, the ends of the next one, and the state."""
        last_error, after_rejection, suspicion, failures = controller_state
        error = self._error_norm(*jax.lax.stop_gradient((y0, y1_candidate, y_error)))
        long = jnp.abs(t1 - t0) > _CONTROL.jump_factor * _CONTROL.min_step * _spacing(t0)
        error = jnp.where(
            (suspicion > _CONTROL.min_suspicion) & long, _CONTROL.jump_factor * error, error
        )
        keep, exponent, results = error <= 1.0, 1.0 / error_order, diffrax.RESULTS

        # XLA computes a scalar again for each use outside of `cond`, and once for its branches.
        def accept() -> Any:
            # proportional-integral control; an error of zero gives infinity: the largest factor
            grown = error**-_CONTROL.last_power * last_error**_CONTROL.before_last_power
            largest = jnp.where(after_rejection, 1.0, _CONTROL.max_factor)
            factor = jnp.clip(_CONTROL.safety * grown**exponent, _CONTROL.min_factor, largest)
            size = (t1 - t0) * factor.astype(jnp.result_type(t1))
            if self.max_step is not None:
                size = jnp.minimum(size, self.max_step)
            size = jnp.maximum(size, _CONTROL.min_step * _spacing(t1))
            kept = jnp.maximum(error, _CONTROL.min_last_error)
            lowered = jnp.maximum(suspicion - 1, 0)
            return t1, t1 + size, kept, lowered, jnp.zeros_like(failures), results.successful

        def reject() -> Any:
            finite = jnp.isfinite(error)
            factor = jnp.maximum(_CONTROL.min_factor, _CONTROL.safety * error**-exponent)
            factor = jnp.where(finite, factor, _CONTROL.failure_factor)
            size = (t1 - t0) * factor.astype(jnp.result_type(t1))
            count = jnp.where(finite, 0, failures + 1).astype(failures.dtype)
            too_small = (size < _CONTROL.min_step * _spacing(t0)) | (count >= _MAX_FAILURES)
            result = results.where(finite, results.dt_min_reached, results.nonfinite)
            result = results.where(too_small, result, results.successful)
            raised = jnp.minimum(suspicion + _CONTROL.raised_by_rejection, _CONTROL.max_suspicion)
            return t0, t0 + size, last_error, raised, count, result

        start, end, last_error, suspicion, failures, result = jax.lax.cond(keep, accept, reject)
        return keep, start, end, False, (last_error, ~keep, suspicion, failures), result

    def _error_norm(self, y0: JaxArray, y1: JaxArray, difference: JaxArray) -> JaxArray:
        """Return the norm of an error estimate relative to the tolerances, infinite for NaN."""
        rules = rules_of(self.frame)
        if rules.log is not None:
            difference = rules.coefficients(y1, difference)
        error = self.norm(difference / self._scale(y0, y1))
        return jnp.where(jnp.isnan(error), jnp.inf, error)

    def _scale(self, x: JaxArray, y: JaxArray) -> JaxArray:
        """Return the tolerances at the larger of two points, all positive."""
        largest = rules_of(self.frame).extent(x, y)
        dtype = largest.dtype
        scale = self.atol.astype(dtype) + self.rtol.astype(dtype) * largest
        return jnp.maximum(scale, jnp.finfo(dtype).tiny)


def _spacing(t: JaxArray) -> JaxArray:
    """Return the distance from |t| to the next larger number."""
    # The next number by its bits; XLA makes a hundred instructions of each jnp.nextafter.
    size = jnp.abs(jax.lax.stop_gradient(t))
    bits = jax.lax.bitcast_convert_type(size, jnp.dtype(f"int{8 * size.dtype.itemsize}"))
    return jax.lax.bitcast_convert_type(bits + 1, size.dtype) - size


def _step_by_derivatives(
    size: JaxArray, slope: JaxArray, curvature: JaxArray, error_order: float
) -> JaxArray:
    """Return the first step by which the error is `first_error`, infinite for zero derivatives.

    The rate at which the solution changes, the larger of curvature / slope and slope / size,
    estimates the higher derivatives.
    """
    moving = slope > 0.0
    safe = jnp.where(moving, slope, 1.0)
    rate = jnp.maximum(curvature / safe, jnp.where(size > 0.0, safe / size, 0.0))
    rated = moving & (rate > 0.0)
    unit = jnp.where(rated, rate, 1.0)
    by_rate = (_CONTROL.first_error * unit / safe) ** (1.0 / error_order) / unit
    by_curvature = jnp.sqrt(_CONTROL.first_error / jnp.where(curvature > 0.0, curvature, 1.0))
    bent = ~moving & (curvature > 0.0)
    return jnp.where(rated, by_rate, jnp.where(bent, by_curvature, jnp.inf))


class Estimate(NamedTuple):
    """An estimate of the error: its tangent, and its coordinates or the square of its norm."""

    tangent: JaxArray
    measured: JaxArray  # see `Rules.measured`; after `squared` the square of the norm

    def squared(self, size: JaxArray) -> Estimate:
        """Return the estimate with the square of its norm."""
        return Estimate(self.tangent, (jnp.abs(self.measured / size) ** 2).sum())


Part = list[Estimate]  # e1, the estimate of kinks if the method has one, and e2 if there is one


class LastStep(eqx.Module):
    """The step before: its size, zero without one, and the coefficients at its nodes."""

    h: JaxArray
    values: JaxArray


def error_estimate(
    table: MethodTable, start: Start, stages: Stages, last_step: LastStep | None
) -> JaxArray | None:
    """Return the estimate, of Magnus methods after another step; None without a pair.

    It is a tangent at the end of the step, without derivatives: sizes of steps are held fixed.
    """
    fixed = jax.lax.stop_gradient
    rules, h, y0, y1 = start.rules, fixed(start.h), fixed(start.y0), fixed(stages.result)
    values, last_step = fixed(stages.values), fixed(last_step)
    changes = h * (values[1:] - values[0])

    def of_vector(v: JaxArray) -> Estimate:
        return Estimate(rules.field(v, y1), rules.measured(v, y1))

    if rules.log is None:
        differences = [Estimate(y1 - result, y1 - result) for result in fixed(stages.other_results)]
    else:
        differences = [of_vector(rules.log(result, y1)) for result in fixed(stages.other_results)]
    sums = [of_vector(v) for v in h * fixed(stages.errors)]
    if not differences and not sums:
        return None
    size = 1.0 + rules.extent(y0, y1)  # the tolerances where rtol and atol are both 1
    parts = [[e.squared(size) for e in part] for part in _parts(table, differences, sums)]
    if last_step is None:
        error = _error_of_parts(table, parts)
    else:
        nodes = of_vector(_node_difference(table, values, h, last_step)).squared(size)
        change = jax.vmap(lambda v: turning(rules.frame, v))(changes).max()
        sizes = jax.vmap(lambda v: jnp.abs(rules.measured(v, y1) / size) ** 2)(changes)
        variation = jnp.where(
            last_step.h == 0.0, jnp.sqrt(sizes.reshape(len(sizes), -1).sum(1).max()), jnp.inf
        )
        error = _magnus_error(table, parts, nodes, change, variation)
    too_large = turning(rules.frame, h * values[0]) > _ESTIMATE.max_angle
    return jax.lax.cond(
        too_large, lambda: _at_large_angle(rules, changes, y1, error), lambda: error
    )


def _at_large_angle(rules: Rules, changes: JaxArray, y1: JaxArray, error: JaxArray) -> JaxArray:
    """Return the largest change of the coefficients in the step, or the error if it is larger.

    At large angles the estimate is unreliable, but constant coefficients may turn by any angle.
    ``raise_by_angle`` in ``fortran/steps/error_estimate.f90`` raises the error by a power of the
    angle.
    """
    largest = rules.field(changes[jnp.argmax((changes**2).sum(axis=1))], y1)
    larger = (jnp.abs(largest) ** 2).sum() > (jnp.abs(error) ** 2).sum()
    return jnp.where(larger, largest, error)


def _parts(table: MethodTable, differences: Part, sums: Part) -> list[Part]:
    """Return the estimates of each part, in the form of the method's estimate."""
    if table.estimate is EstimateForm.PARTS_OF_RESULTS:
        pairs = zip(differences, (sums[0], sums[-1]), strict=True)
        return [sums, [Estimate(*map(operator.sub, *pair)) for pair in pairs]]
    if table.estimate is EstimateForm.PARTS_OF_SUMS:
        return [sums[::2], sums[1::2]]
    if table.estimate is EstimateForm.PARTS_OF_SERIES:
        count = len(table.errors)
        return [sums[:count], sums[count:]]
    return [differences + sums]


def _magnus_error(
    table: MethodTable, parts: list[Part], nodes: Estimate, change: JaxArray, variation: JaxArray
) -> JaxArray:
    """Return the error of a Magnus method: of its results, or of the interpolation at its nodes.

    ``change`` is the largest angle by which coefficients change in the step. ``variation`` is the
    norm of the largest change in a first step, infinite in others, whose `nodes` see fast changes.
    """
    tangents = [[tangent for tangent, _ in part] for part in parts]
    norms = [[_norm(square) for _, square in part] for part in parts]
    estimates = [
        (e1 / jnp.hypot(e1, table.record.factor * e2[0])) ** table.record.power * e1 if e2 else e1
        for e1, *e2 in norms
    ]
    size = sum(estimates)
    of_results = tangents[0][0] * (size / norms[0][0])
    if len(parts) > 1:
        (quadrature1, quadrature2), (commutator1, commutator2) = norms
        scaled = tangents[1][0] * (size / commutator1)
        of_results = jnp.where(estimates[1] > estimates[0], scaled, of_results)
        # Commutators are of third order in the step; this share of them has the order of the error.
        share = (change / _ESTIMATE.unit_of_change) ** (1.0 / table.exponent - 3.0)
        of_results = jnp.where(share * commutator2 > size, share * tangents[1][1], of_results)
        size = jnp.maximum(size, share * commutator2)
        fast = quadrature1 > _ESTIMATE.resolved_first * variation
        fast_size = jnp.where(fast, quadrature1, quadrature2)
        fast_error = jnp.where(fast, *tangents[0])
        unresolved = (fast | (quadrature2 > _ESTIMATE.resolved_second * variation)) & (
            fast_size > size
        )
        of_results = jnp.where(unresolved, fast_error, of_results)
        size = jnp.where(unresolved, fast_size, size)
    return jnp.where(_norm(nodes.measured) > size, nodes.tangent, of_results)


def _norm(square: JaxArray) -> JaxArray:
    return jnp.sqrt(jnp.maximum(square, jnp.finfo(square.dtype).tiny))


def _error_of_parts(table: MethodTable, parts: list[Part]) -> JaxArray:
    """Return the error of other methods: the larger one of two parts."""
    if table.estimate is EstimateForm.AT_END:
        return _error_at_end(table, *parts[0])
    (error, square), *others = (_quotient(table, *part) for part in parts)
    for other, other_square in others:
        error = jnp.where(other_square > square, other, error)
    return error


def _quotient(table: MethodTable, e1: Estimate, *others: Estimate) -> Estimate:
    """Return a quotient of power 1 of e1, kinks if there are any, and e2, and its squared norm."""
    if not others:
        return e1
    (error, square), *kinks, (_, square2) = e1, *others
    for kink, kink_square in kinks:
        error = jnp.where(kink_square > square, kink, error)
        square = jnp.maximum(square, kink_square)
    total = jnp.maximum(square + table.record.factor**2 * square2, jnp.finfo(square.dtype).tiny)
    share = square / total
    return Estimate(jnp.sqrt(share) * error, share * square)


def _error_at_end(table: MethodTable, e1: Estimate, e2: Estimate, *e3: Estimate) -> JaxArray:
    """Return the error in the form `AT_END`, of a difference e1 and one or two sums."""
    factor, (at_end, end) = table.record.factor, e2
    for _, square in e3:
        share = end / jnp.maximum(end + square, jnp.finfo(end.dtype).tiny)
        end, at_end = end * share, jnp.sqrt(share) * at_end
    return jnp.where(factor**2 * end > e1.measured, factor * at_end, e1.tangent)


def _node_difference(table: MethodTable, values: JaxArray, h: JaxArray, last: LastStep) -> JaxArray:
    """Return the largest error of interpolation between the nodes times h, zero in a first step.

    With the highest divided difference D of the coefficients over the nodes t_i of both steps, it
    is h D max_m |prod_i (m - t_i)| over the middles m between nodes of this step; D below rounding
    counts as zero. As in ``fortran/steps/error_estimate.f90``.
    """
    c = table.c
    moves = h != 0.0
    ratio = last.h / jnp.where(moves, h, 1.0)
    earlier = (jnp.asarray(c, h.dtype) - 1.0) * ratio
    fields = last.values
    if c[-1] == 1.0 and c[0] == 0.0:  # the end of the step before is the start of this one
        earlier, fields = earlier[:-1], fields[:-1]
    times = jnp.concatenate([earlier, jnp.asarray(c, h.dtype)])
    fields = jnp.concatenate([fields, values])
    has_last = moves & (last.h != 0.0)
    times = jnp.where(has_last, times, jnp.arange(len(times), dtype=h.dtype))
    apart = times[:, None] - times + jnp.eye(len(times), dtype=h.dtype)
    weights = 1.0 / apart.prod(axis=1)
    middles = 0.5 * (times[-len(c) : -1] + times[-len(c) + 1 :])
    largest = jnp.abs((middles[:, None] - times).prod(axis=1)).max()
    difference = weights @ fields
    rounding = _ESTIMATE.roundings * jnp.finfo(h.dtype).eps * (jnp.abs(weights) @ jnp.abs(fields))
    significant = has_last & (jnp.abs(difference) > rounding)
    return h * largest * jnp.where(significant, difference, 0.0)
