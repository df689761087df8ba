"""Error estimates of steps, as tangents at their ends."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cg.frames import SO, SO3, SU, Frame, Power, Product, U, UnitQuaternion
from cg.jax.entire import JaxArray
from cg.jax.linear import Before, magnus_error, node_difference
from cg.jax.rules import linear
from cg.jax.stages import Stages, Start, Steps
from cg.method.estimate import MAX_ANGLE


def error_estimate(
    steps: Steps, start: Start, stages: Stages, before: Before | None
) -> JaxArray | None:
    """Return the estimate, of Magnus methods after another step; None without a pair."""
    if before is None:
        error = _error(steps, start, stages)
    else:
        error = _error_of_time(steps, start, stages, before)
    if error is None:
        return None
    angle = _turning(start.rules.frame, start.h * stages.values[0])
    return jax.lax.cond(angle > MAX_ANGLE, lambda: _change(start, stages, error), lambda: error)


def _change(start: Start, stages: Stages, error: JaxArray) -> JaxArray:
    """Return the error of a step whose angle is too large to believe the estimate.

    It is the largest change of the coefficients in the step if that is larger, as in
    ``fortran/steps/step.f90``: constant coefficients may turn by any angle.
    """
    changes = start.h * (stages.values - stages.values[0])
    largest = changes[jnp.argmax((changes**2).sum(axis=1))]
    change = start.rules.field(largest, stages.result)
    return jnp.where((jnp.abs(change) ** 2).sum() > (jnp.abs(error) ** 2).sum(), change, error)


def _turning(frame: Frame, v: JaxArray) -> JaxArray:
    """Return the angle of a flow, as ``turning`` in ``fortran/frames/algebra.f90``."""
    if isinstance(frame, Product):
        parts = zip(frame.factors, frame._vector_slices, strict=True)
        return jnp.stack([_turning(factor, v[place]) for factor, place in parts]).max()
    if isinstance(frame, Power):
        return jax.vmap(lambda part: _turning(frame.factor, part))(v.reshape(frame.n, -1)).max()
    group = SO3() if isinstance(frame, UnitQuaternion) else getattr(frame, "group", frame)
    if not isinstance(group, SO | SO3 | SU | U):
        return jnp.zeros((), v.dtype)
    square = (jnp.abs(linear(v[: group.dim], group.basis)) ** 2).sum()
    factor = 2.0 if isinstance(group, SU | U) else 1.0 if group.size > 3 else 0.5
    return jnp.sqrt(factor * square)


def _error_of_time(steps: Steps, start: Start, stages: Stages, before: Before) -> JaxArray | None:
    """Return the estimate of a Magnus method as a tangent; None without a pair."""
    if stages.embedded is None:
        return None
    others = [stages.embedded, *([] if stages.third is None else [stages.third])]
    unseen = node_difference(steps.paths, stages.values, start.h, before)
    return magnus_error(steps.paths, start.rules, start.y0, stages.result, others, unseen)


def _error(steps: Steps, start: Start, stages: Stages) -> JaxArray | None:
    """Return the estimate as a tangent at the end of the step; None without a pair.

    Two estimates are made one as in DOP853, or the larger one counts, by norms that are those of
    `controller` where both of its tolerances are equal.
    """
    rules, h, y1, other = start.rules, start.h, stages.result, stages.embedded
    if other is None and not steps.paths.errors:
        return None
    estimates = list(h * stages.errors)
    if other is not None and rules.log is None:
        error = y1 - other
        measured = [error]
    else:
        if other is not None:
            assert rules.log is not None
            estimates.insert(0, rules.log(other, y1))
        error = rules.field(estimates[0], y1)
        measured = []
    measured += [rules.measured(each, y1) for each in estimates]
    if len(measured) > 1:
        size = rules.extent(start.y0, y1)
        squares = [(jnp.abs(each / size) ** 2).sum() for each in measured]
        if steps.paths.power == 0:
            at_end = rules.field(estimates[-len(steps.paths.errors)], y1)
            return _larger(error, float(steps.paths.factor) * at_end, steps, squares)
        if len(measured) > 2:  # with `kink_weights`
            kinks = rules.field(estimates[-2], y1)
            error = jnp.where(squares[1] > squares[0], kinks, error)
            squares = [jnp.maximum(*squares[:2]), squares[2]]
        total = jnp.maximum(squares[0] + 0.01 * squares[1], jnp.finfo(h.dtype).tiny)
        error = jax.lax.stop_gradient(jnp.sqrt(squares[0] / total)) * error
    return error


def _larger(error: JaxArray, at_end: JaxArray, steps: Steps, squares: list[JaxArray]) -> JaxArray:
    """Return the error, or that at the end of the step if it is larger, see `end_weights`."""
    end = squares[1]
    if len(squares) > 2:
        share = end / jnp.maximum(end + squares[2], jnp.finfo(end.dtype).tiny)
        end, at_end = end * share, jax.lax.stop_gradient(jnp.sqrt(share)) * at_end
    return jnp.where(float(steps.paths.factor) ** 2 * end > squares[0], at_end, error)
