"""Error estimates of steps, as tangents at their ends.

An estimate is the difference of two results, or a weighted sum of the coefficients at stages. Two
estimates with norms e and d are made one: the first times e / sqrt(e² + d²/100) as in DOP853, of
Magnus methods times (e / hypot(e, factor d))^power, or the larger one. Norms are those of
`controller` where both of its tolerances are equal.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from cg.frames import SO, SO3, SU, Frame, Power, Product, U, UnitQuaternion
from cg.integration.step.paths import MethodPaths
from cg.jax.entire import JaxArray
from cg.jax.rules import Rules
from cg.jax.stages import Stages, Start, Steps
from cg.method.estimate import MAX_ANGLE

_ROUNDINGS = 64  # as in fortran/steps/error_estimate.f90

Estimate = tuple[JaxArray, JaxArray]  # a tangent, and what its norm is computed from


class Before(eqx.Module):
    """The step before: its size, zero without one, and the coefficients at its nodes."""

    h: JaxArray
    values: JaxArray


def no_step(paths: MethodPaths, first: JaxArray) -> Before:
    """Return the step before a first one."""
    count = len(paths.stages)
    return Before(jnp.zeros((), first.dtype), jnp.zeros((count, len(first)), first.dtype))


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
    """Return the angle of a flow, as ``turning`` in ``fortran/frames/error_norm.f90``."""
    if isinstance(frame, Product):
        parts = zip(frame.factors, frame._vector_slices, strict=True)
        return jnp.stack([_turning(factor, v[place]) for factor, place in parts]).max()
    if isinstance(frame, Power):
        return jax.vmap(lambda part: _turning(frame.factor, part))(v.reshape(frame.n, -1)).max()
    group = SO3() if isinstance(frame, UnitQuaternion) else getattr(frame, "group", frame)
    if not isinstance(group, SO | SU | U):
        return jnp.zeros((), v.dtype)
    factor = 2.0 if isinstance(group, SO) and group.n > 3 else 1.0
    return jnp.sqrt(factor * (v[: group.dim] @ v[: group.dim]))


def _of_vector(rules: Rules, v: JaxArray, y1: JaxArray) -> Estimate:
    return rules.field(v, y1), rules.measured(v, y1)


def _of_results(rules: Rules, stages: Stages) -> list[Estimate]:
    """Return the differences of the result and others."""
    y1 = stages.result
    if rules.log is None:
        return [(y1 - other, y1 - other) for other in stages.others]
    return [_of_vector(rules, rules.log(other, y1), y1) for other in stages.others]


def _error_of_time(steps: Steps, start: Start, stages: Stages, before: Before) -> JaxArray | None:
    """Return the estimate of a Magnus method: that of the results, or the larger of the nodes."""
    if not stages.others and not len(stages.errors):
        return None
    rules, y1, paths = start.rules, stages.result, steps.paths
    size = rules.extent(start.y0, y1)

    def norm(estimate: Estimate) -> JaxArray:
        squares = (jnp.abs(estimate[1] / size) ** 2).sum()
        return jnp.sqrt(jnp.maximum(squares, jnp.finfo(size.dtype).tiny))

    estimates = _of_results(rules, stages)
    estimates += [_of_vector(rules, v, y1) for v in start.h * stages.errors]
    norms = [norm(each) for each in estimates]
    scale = jnp.ones((), size.dtype)
    if len(norms) == 2:
        factor = float(paths.factor)
        scale = (norms[0] / jnp.hypot(norms[0], factor * norms[1])) ** paths.power
    scale = jax.lax.stop_gradient(scale)
    unseen = _of_vector(rules, _node_difference(paths, stages.values, start.h, before), y1)
    return jnp.where(norm(unseen) > scale * norms[0], unseen[0], scale * estimates[0][0])


def _error(steps: Steps, start: Start, stages: Stages) -> JaxArray | None:
    """Return the estimate as a tangent at the end of the step; None without a pair."""
    rules, h, y1 = start.rules, start.h, stages.result
    estimates = _of_results(rules, stages)
    estimates += [_of_vector(rules, v, y1) for v in h * stages.errors]
    if not estimates:
        return None
    error = estimates[0][0]
    if len(estimates) == 1:
        return error
    size = rules.extent(start.y0, y1)
    squares = [(jnp.abs(measured / size) ** 2).sum() for _, measured in estimates]
    if steps.paths.power == 0:
        at_end = estimates[-len(steps.paths.errors)][0]
        return _larger(error, float(steps.paths.factor) * at_end, steps, squares)
    if len(estimates) > 2:  # with `kink_weights`
        error = jnp.where(squares[1] > squares[0], estimates[-2][0], error)
        squares = [jnp.maximum(*squares[:2]), squares[2]]
    total = jnp.maximum(squares[0] + 0.01 * squares[1], jnp.finfo(h.dtype).tiny)
    return jax.lax.stop_gradient(jnp.sqrt(squares[0] / total)) * error


def _larger(error: JaxArray, at_end: JaxArray, steps: Steps, squares: list[JaxArray]) -> JaxArray:
    """Return the error, or that at the end of the step if it is larger, see `end_weights`."""
    end = squares[1]
    if len(squares) > 2:
        share = end / jnp.maximum(end + squares[2], jnp.finfo(end.dtype).tiny)
        end, at_end = end * share, jax.lax.stop_gradient(jnp.sqrt(share)) * at_end
    return jnp.where(float(steps.paths.factor) ** 2 * end > squares[0], at_end, error)


def _node_difference(paths: MethodPaths, values: JaxArray, h: JaxArray, before: Before) -> JaxArray:
    """Return the largest error of interpolation between the nodes times h, zero in a first step.

    With the highest divided difference D of the coefficients over the nodes t_i of both steps, it
    is h D max_m |prod_i (m - t_i)| over the middles m between nodes of this step; D below rounding
    counts as zero. As in ``fortran/steps/error_estimate.f90``.
    """
    c = np.asarray(paths.abscissae)
    known = h != 0.0
    ratio = before.h / jnp.where(known, h, 1.0)
    earlier = (jnp.asarray(c, h.dtype) - 1.0) * ratio
    fields = before.values
    if c[-1] == 1.0 and c[0] == 0.0:  # the end of the step before is the start of this one
        earlier, fields = earlier[:-1], fields[:-1]
    times = jnp.concatenate([earlier, jnp.asarray(c, h.dtype)])
    fields = jnp.concatenate([fields, values])
    used = known & (before.h != 0.0)
    times = jnp.where(used, times, jnp.arange(len(times), dtype=h.dtype))
    apart = times[:, None] - times + jnp.eye(len(times), dtype=h.dtype)
    weights = 1.0 / apart.prod(axis=1)
    middles = 0.5 * (times[-len(c) : -1] + times[-len(c) + 1 :])
    largest = jnp.abs((middles[:, None] - times).prod(axis=1)).max()
    difference = weights @ fields
    rounding = _ROUNDINGS * jnp.finfo(h.dtype).eps * (jnp.abs(weights) @ jnp.abs(fields))
    seen = used & (jnp.abs(difference) > rounding)
    return h * largest * jnp.where(seen, difference, 0.0)
