"""Error estimates of steps, as tangents at their ends.

An estimate is the difference of two results, or a weighted sum of the coefficients at stages. Two
estimates with norms e and d are made one: the first times e / sqrt(e² + d²/100) as in DOP853, or
the larger one. Those of Magnus methods and of methods on the algebra have two parts, of quadratures
and of commutators, each of which counts times (e / hypot(e, factor d))^power, see
``fortran/steps/error_estimate.f90``. Norms are those of `controller` where both of its tolerances
are equal.
"""

from __future__ import annotations

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp

from cg.frames import SO, SO3, SU, Frame, Power, Product, U, UnitQuaternion
from cg.jax.entire import JaxArray
from cg.jax.stages import Stages, Start
from cg.support.shared_numbers import ERROR_ESTIMATE
from cg.tables import MAX_ANGLE, Kind, MethodTable

_NUMBERS = SimpleNamespace(**ERROR_ESTIMATE)

Estimate = tuple[JaxArray, JaxArray]  # a tangent, and what its norm is computed from


class Before(eqx.Module):
    """The step before: its size, zero without one, and the coefficients at its nodes."""

    h: JaxArray
    values: JaxArray


def no_step(table: MethodTable, first: JaxArray) -> Before:
    """Return the step before a first one."""
    count = len(table.c)
    return Before(jnp.zeros((), first.dtype), jnp.zeros((count, len(first)), first.dtype))


def error_estimate(
    table: MethodTable, start: Start, stages: Stages, before: Before | None
) -> JaxArray | None:
    """Return the estimate, of Magnus methods after another step; None without a pair.

    It is a tangent at the end of the step.
    """
    rules, h, y1 = start.rules, start.h, stages.result

    def of_vector(v: JaxArray) -> Estimate:
        return rules.field(v, y1), rules.measured(v, y1)

    if rules.log is None:
        estimates = [(y1 - other, y1 - other) for other in stages.others]
    else:
        estimates = [of_vector(rules.log(other, y1)) for other in stages.others]
    sums = [of_vector(v) for v in h * stages.errors]
    if len(estimates) > 1:  # with a third result, whose parts are known
        rest = [
            (whole[0] - part[0], whole[1] - part[1])
            for whole, part in zip(estimates, (sums[0], sums[-1]), strict=True)
        ]
        if table.kind is Kind.LINEAR:
            estimates, sums = [sums[0], rest[0], sums[1], rest[1]], []
        else:
            estimates, sums = [*sums, *rest], []
    estimates += sums
    if not estimates:
        return None
    if before is not None:
        estimates.append(of_vector(_node_difference(table, stages.values, h, before)))
    size = rules.extent(start.y0, y1)
    errors = [tangent for tangent, _ in estimates]
    squares = [(jnp.abs(measured / size) ** 2).sum() for _, measured in estimates]
    if before is None:
        error = _error(table, errors, squares)
    else:
        changes = h * (stages.values[1:] - stages.values[0])
        change = jax.vmap(lambda v: turning(rules.frame, v))(changes).max()
        sizes = jax.vmap(lambda v: jnp.abs(rules.measured(v, y1) / size) ** 2)(changes)
        variation = jnp.where(
            before.h == 0.0, jnp.sqrt(sizes.reshape(len(sizes), -1).sum(1).max()), jnp.inf
        )
        error = _error_of_time(table, errors, squares, change, variation)
    angle = turning(rules.frame, h * stages.values[0])
    return jax.lax.cond(angle > MAX_ANGLE, lambda: _change(start, stages, error), lambda: error)


def _change(start: Start, stages: Stages, error: JaxArray) -> JaxArray:
    """Return the error of a step whose angle is too large to believe the estimate.

    It is the largest change of the coefficients in the step if that is larger: constant
    coefficients may turn by any angle. ``limit_angle`` in ``fortran/steps/error_estimate.f90``
    raises the error by a power of the angle there.
    """
    changes = start.h * (stages.values - stages.values[0])
    largest = changes[jnp.argmax((changes**2).sum(axis=1))]
    change = start.rules.field(largest, stages.result)
    return jnp.where((jnp.abs(change) ** 2).sum() > (jnp.abs(error) ** 2).sum(), change, error)


def turning(frame: Frame, v: JaxArray) -> JaxArray:
    """Return the angle of a flow, as ``turning`` in ``fortran/frames/frames.f90``."""
    if isinstance(frame, Product):
        parts = zip(frame.factors, frame._vector_slices, strict=True)
        return jnp.stack([turning(factor, v[place]) for factor, place in parts]).max()
    if isinstance(frame, Power):
        return jax.vmap(lambda part: turning(frame.factor, part))(v.reshape(frame.n, -1)).max()
    group = SO3() if isinstance(frame, UnitQuaternion) else getattr(frame, "group", frame)
    if not isinstance(group, SO | SU | U):
        return jnp.zeros((), v.dtype)
    factor = 2.0 if isinstance(group, SO) and group.n > 3 else 1.0
    return jnp.sqrt(factor * (v[: group.dim] @ v[: group.dim]))


def _error_of_time(
    table: MethodTable,
    errors: list[JaxArray],
    squares: list[JaxArray],
    change: JaxArray,
    variation: JaxArray,
) -> JaxArray:
    """Return the error of a Magnus method: that of the results, or the larger of the nodes.

    ``change`` is that of the angle of coefficients in the step, ``variation`` that of the
    coefficients in a first step, in others infinite.
    """
    norms = [jnp.sqrt(jnp.maximum(square, jnp.finfo(square.dtype).tiny)) for square in squares]
    *parts, last = norms
    count = max(len(parts) // 2, 1)
    shares = [
        (e / jnp.hypot(e, table.record.factor * d)) ** table.record.power
        for e, d in zip(parts, parts[count:], strict=False)
    ] or [jnp.ones_like(last)]
    estimates = [share * norm for share, norm in zip(shares, norms, strict=False)]
    size = sum(estimates)
    of_results = errors[0] * jax.lax.stop_gradient(size / norms[0])
    if len(estimates) > 1:
        scaled = errors[1] * jax.lax.stop_gradient(size / norms[1])
        of_results = jnp.where(estimates[1] > estimates[0], scaled, of_results)
        share = (change / _NUMBERS.unit_of_change) ** (1.0 / table.exponent - 3.0)
        of_change = jax.lax.stop_gradient(share) * errors[3]
        of_results = jnp.where(share * norms[3] > size, of_change, of_results)
        size = jnp.maximum(size, share * norms[3])
        fast = norms[0] > _NUMBERS.resolved_first * variation
        first = jnp.where(fast, norms[0], norms[2])
        fast_error = jnp.where(fast, errors[0], errors[2])
        unresolved = (fast | (norms[2] > _NUMBERS.resolved_second * variation)) & (first > size)
        of_results = jnp.where(unresolved, fast_error, of_results)
        size = jnp.where(unresolved, first, size)
    return jnp.where(last > size, errors[-1], of_results)


def _error(table: MethodTable, errors: list[JaxArray], squares: list[JaxArray]) -> JaxArray:
    """Return the error of other methods, one of up to three estimates."""
    error = errors[0]
    if len(errors) == 1:
        return error
    if table.record.power == 0:
        return _larger(table, errors, squares)
    sums = len(table.errors)
    if sums > 1:  # in parts
        scaled, sizes = zip(
            _quotient(table, errors[:sums], squares[:sums]),
            _quotient(table, errors[sums:], squares[sums:]),
            strict=True,
        )
        return jnp.where(sizes[1] > sizes[0], scaled[1], scaled[0])
    return _quotient(table, errors, squares)[0]


def _quotient(
    table: MethodTable, errors: list[JaxArray], squares: list[JaxArray]
) -> tuple[JaxArray, JaxArray]:
    """Return the estimate of DOP853 and the square of its norm."""
    error = errors[0]
    if len(errors) > 2:  # with `kink_weights`
        error = jnp.where(squares[1] > squares[0], errors[-2], error)
        squares = [jnp.maximum(*squares[:2]), squares[2]]
    further = table.record.factor**2 * squares[1]
    total = jnp.maximum(squares[0] + further, jnp.finfo(squares[0].dtype).tiny)
    share = squares[0] / total
    return jax.lax.stop_gradient(jnp.sqrt(share)) * error, share * squares[0]


def _larger(table: MethodTable, errors: list[JaxArray], squares: list[JaxArray]) -> JaxArray:
    """Return the error, or that at the end of the step if it is larger, see `end_weights`."""
    factor, end, at_end = table.record.factor, squares[1], errors[-len(table.errors)]
    if len(squares) > 2:
        share = end / jnp.maximum(end + squares[2], jnp.finfo(end.dtype).tiny)
        end, at_end = end * share, jax.lax.stop_gradient(jnp.sqrt(share)) * at_end
    return jnp.where(factor**2 * end > squares[0], factor * at_end, errors[0])


def _node_difference(table: MethodTable, values: JaxArray, h: JaxArray, before: Before) -> JaxArray:
    """Return the largest error of interpolation between the nodes times h, zero in a first step.

    With the highest divided difference D of the coefficients over the nodes t_i of both steps, it
    is h D max_m |prod_i (m - t_i)| over the middles m between nodes of this step; D below rounding
    counts as zero. As in ``fortran/steps/error_estimate.f90``.
    """
    c = table.c
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
    rounding = _NUMBERS.roundings * jnp.finfo(h.dtype).eps * (jnp.abs(weights) @ jnp.abs(fields))
    seen = used & (jnp.abs(difference) > rounding)
    return h * largest * jnp.where(seen, difference, 0.0)
