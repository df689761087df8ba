"""Stages of a step, as paths of flows or in a Lie algebra, and interpolants between steps.

`cg.construction.methods.paths` explains paths, `cg.construction.methods.interpolant` interpolants.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import Polynomial

from cg.jax.rules import JaxArray, Rules, linear
from cg.support.arrays import Array
from cg.support.caches import cached
from cg.support.shared_numbers import EstimateForm
from cg.tables import Kind, MethodTable, basis_polynomials

_NEWTON_STEPS = 3  # each squares an error that is of third order at first


@dataclass(frozen=True)
class Start:
    """The start of a step: its point, ``at_start``, the coefficients there, and its size.

    ``f(c, y)`` returns the coefficients at a point and a fraction of the step.
    """

    rules: Rules
    f: Callable[[Any, JaxArray], JaxArray]
    h: JaxArray
    y0: JaxArray
    at_start: JaxArray


@dataclass(frozen=True)
class Stages:
    """The results of a step, and the coefficients at its stages.

    With `PARTS_OF_SERIES` sums of coefficients are the first half of ``errors``, and sums of what
    dexpinv has added to them the second.
    """

    values: JaxArray  # (stages, dim) coefficients, on the algebra derivatives of coordinates
    result: JaxArray  # the point at the end of the step
    others: list[JaxArray]  # second and third results, with which the result is compared
    errors: JaxArray  # (sums, dim) weighted sums of values: error estimates divided by the step
    at_end: JaxArray | None  # coefficients at the result, None if no stage is there
    vectors: JaxArray  # values, then brackets of a Magnus method or values at nodes of output


def take_stages(table: MethodTable, start: Start, *, unroll: bool, evaluations: int) -> Stages:
    """Return stages and results; on the algebra the first ``evaluations`` of ``f`` are one loop."""
    if table.on_algebra:
        return _take_stages_on_algebra(table, start, unroll, evaluations)
    rules, f, h, y0 = start.rules, start.f, start.h, start.y0
    record, c = table.record, table.c
    at_end = None
    stages: list[JaxArray] = []
    ends = [y0]
    results = {record.result, record.embedded, record.third}

    def follow_paths(count: int) -> None:
        """Follow the first paths, as far as they haven't been followed yet."""
        for k in range(len(ends), count + 1):
            origin, flows = table.paths[k - 1]
            y = ends[origin]
            for row in flows:
                # Without the barrier XLA compiles a flow once for each of its consumers. Then
                # rounding errors, and with them sizes of steps, differ between the forward pass
                # and its repetition by an adjoint.
                y = jax.lax.optimization_barrier(rules.flow(_displacement(h, row, stages), y))
            ends.append(rules.restore(y) if k in results else y)

    if table.kind is Kind.LINEAR:
        stages = list(jax.vmap(lambda at: f(at, y0))(jnp.asarray(c, h.dtype)))
        at_end = stages[-1] if c[-1] == 1.0 else None
        for pair in table.brackets:
            u, v = (_displacement(h, row, stages) for row in pair)
            stages.append(v @ linear(u, rules.frame._adjoint_basis) / h)
    stage_paths = table.arrays["stage_path"].tolist()
    for at, k in zip(c.tolist()[len(stages) :], stage_paths, strict=False):
        follow_paths(k)
        value = start.at_start if k == 0 and at == 0.0 and not stages else f(at, ends[k])
        if len(stages) + 1 == record.final_stage:
            at_end = value
        stages.append(value)
    follow_paths(len(table.paths))
    others = [ends[k] for k in (record.embedded, record.third) if k]
    vectors = jnp.stack(stages)
    errors = jnp.asarray(table.errors, h.dtype) @ vectors
    values = vectors[: len(c)]
    return Stages(values, ends[record.result], others, errors, at_end, vectors)


def _take_stages_on_algebra(
    table: MethodTable, start: Start, unroll: bool, evaluations: int
) -> Stages:
    """Return the stages and the result of a method of Munthe-Kaas.

    Each path is one flow from the start, whose coordinates u are h times a weighted sum of the
    values k = dexpinv(u, f). The end of the step and the nodes of output are stages too, so that
    XLA compiles ``f``, flow and dexpinv once. The value at a stage is added to the sums of all
    paths at once, one kernel of XLA in either mode of differentiation. Reverse mode computes flows
    and dexpinv again, in fewer kernels than it takes to store what their derivatives need.
    """
    rules, f, h, y0, output = start.rules, start.f, start.h, start.y0, table.output
    count, width = len(table.c), output.basis.shape[1]
    paths = [np.zeros(0), *(weights for _, (weights,) in table.paths)]
    stage_paths, ends = table.arrays["stage_path"].astype(int).tolist(), []
    if output.final > count:
        stage_paths, ends = [*stage_paths, table.record.result], [1.0]
    # A loop would carry the sums of these rows in reverse mode too; unrolled, they cost no kernel.
    last = np.stack([paths[table.record.result], *table.errors])
    rows = [*(paths[k] for k in stage_paths[1:]), *output.rows, *(last if unroll else ())]
    weights = np.array([np.pad(row, (0, width - len(row))) for row in rows])
    columns, nodes = jnp.asarray(weights.T, h.dtype), [*table.c, *ends, *output.theta]
    numbers = jnp.arange(-1, width - 1), jnp.asarray(nodes, h.dtype), columns
    assert rules.dexpinv is not None
    flow = jax.checkpoint(rules.flow, prevent_cse=False)
    dexpinv = jax.checkpoint(rules.dexpinv, prevent_cse=False, static_argnums=2)
    series = max(table.record.series, output.series)
    in_parts = table.estimate is EstimateForm.PARTS_OF_SERIES

    def take(sums: JaxArray, stage: Any) -> tuple[JaxArray, tuple[JaxArray | None, ...]]:
        row, c, column = stage
        u = h * sums[row]
        coefficients = f(c, flow(u, y0))
        value = dexpinv(u, coefficients, series)
        added = column[:, None] * value
        if unroll:  # the result doesn't depend on f at the end of the step, which may be infinite
            added = jnp.where(column[:, None] == 0.0, 0.0, added)
        correction = value - coefficients if in_parts else None
        return sums + added, (coefficients, value, correction)

    def loop(sums: JaxArray, chosen: slice, unroll: bool) -> Any:
        return jax.lax.scan(take, sums, [x[chosen] for x in numbers], unroll=unroll)

    sums = columns[0, :, None] * start.at_start
    sums, (coefficients, vectors, corrections) = loop(sums, slice(1, evaluations), unroll)
    at_end = coefficients[output.final - 2] if evaluations >= output.final else None
    vectors = jnp.concatenate([start.at_start[None], vectors])
    values = vectors[:count]
    final = sums[width - 1 :] if unroll else jnp.asarray(last, h.dtype) @ values
    result, errors = rules.restore(rules.flow(h * final[0], y0)), final[1:]
    if evaluations < width:  # XLA removes this loop where no output between steps is asked for
        _, (_, more, _) = loop(sums, slice(evaluations, width), unroll=False)
        vectors = jnp.concatenate([vectors, more])
    if in_parts:  # the correction at the first stage is zero
        corrected = jnp.asarray(table.errors[:, 1:], h.dtype) @ corrections[: count - 1]
        errors = jnp.concatenate([errors - corrected, corrected])
    return Stages(values, result, [], errors, at_end, vectors)


def _displacement(h: JaxArray, row: Array, stages: list[JaxArray]) -> JaxArray:
    """Return h times a weighted sum of coefficients at stages, as one product."""
    used = np.flatnonzero(row)
    if len(used) == 1:
        return (h * float(row[used[0]])) * stages[used[0]]
    return (h * jnp.asarray(row[used], h.dtype)) @ jnp.stack([stages[k] for k in used])


@dataclass(frozen=True, eq=False)
class _Scheme:
    """Weights of flows as polynomials, and whether the interpolant is as accurate as the step.

    ``weights`` are the coefficients of θ, θ², …, shape ``(flows, coefficients, degree)``.
    """

    weights: Array
    accurate: bool = True


class _Interpolant(eqx.Module):
    """The points of a step, reached from its start by flows whose weights are polynomials."""

    y0: JaxArray
    fields: JaxArray
    rules: Rules = eqx.field(static=True)
    scheme: _Scheme = eqx.field(static=True)

    def __call__(self, theta: JaxArray) -> JaxArray:
        weights = jnp.asarray(self.scheme.weights, self.fields.dtype)
        powers = theta.astype(self.fields.dtype) ** jnp.arange(1, weights.shape[2] + 1)
        vectors = (weights @ powers) @ self.fields
        if len(vectors) == 1:
            return self.rules.flow(vectors[0], self.y0)
        return jax.lax.scan(lambda y, v: (self.rules.flow(v, y), None), self.y0, vectors)[0]


class StepInterpolation(diffrax.AbstractLocalInterpolation):
    """The solution within one step, as diffrax asks for it."""

    t0: Any
    t1: Any
    within: _Interpolant

    def evaluate(self, t0: Any, t1: Any = None, left: bool = True) -> JaxArray:
        """Return the point at a time, or the difference of those at two times."""
        if not self.within.scheme.accurate:
            warnings.warn(
                "dense='steps' has errors of second order in the step between the ends of steps; "
                "output and events there need a solver without it. With noise all solvers have "
                "errors of order ½ there: end steps at such times, with diffrax.StepTo",
                stacklevel=2,
            )
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        span = self.t1 - self.t0
        empty = span == 0.0
        theta = jnp.where(empty, 0.0, (t0 - self.t0) / jnp.where(empty, 1.0, span))
        return self.within(theta)


def interpolant(
    table: MethodTable, start: Start, stages: Stages, at_end: JaxArray, *, accurate: bool
) -> _Interpolant:
    """Return the interpolant of a step; ``at_end`` are the coefficients at its end.

    If not ``accurate``, it is made of `_step_scheme`.
    """
    rules = start.rules
    if not accurate:
        fields = start.h * stages.vectors[: table.combined_vectors]
        return _Interpolant(start.y0, fields, rules, _step_scheme(table))
    if table.on_algebra or (rules.unique and rules.dexpinv is not None and rules.log is not None):
        return _on_algebra(table, start, stages, at_end)
    return _by_flows(table, start, stages, at_end)


@cached
def _step_scheme(table: MethodTable) -> _Scheme:
    """Return the flows of the step, with weights proportional to time."""
    return _Scheme(table.result_flows[..., None], accurate=False)


def _on_algebra(table: MethodTable, start: Start, stages: Stages, at_end: JaxArray) -> _Interpolant:
    """Return the interpolant in coordinates, one flow from the start of the step."""
    rules, f, h, y0 = start.rules, start.f, start.h, start.y0
    output, series = table.output, table.output.series
    assert rules.dexpinv is not None
    flow = jax.checkpoint(rules.flow, prevent_cse=False)
    dexpinv = jax.checkpoint(rules.dexpinv, prevent_cse=False, static_argnums=2)
    # all derivatives are times h, which may be zero
    if table.on_algebra:
        derivatives = h * stages.vectors
    else:
        u = _coordinates(rules, 0.5 * h * (start.at_start + at_end), y0, stages.result, series)
        derivatives = jnp.stack([h * start.at_start, u, dexpinv(u, h * at_end, series)])
        count, width = len(derivatives), output.basis.shape[1]
        derivatives = jnp.pad(derivatives, ((0, width - count), (0, 0)))

        def evaluate(k: JaxArray, node: Any) -> tuple[JaxArray, None]:
            at, theta, row = node
            u = row @ k
            value = dexpinv(u, h * f(theta, flow(u, y0)), series)
            return k.at[at].set(value), None

        theta, rows = (jnp.asarray(x, h.dtype) for x in (output.theta, output.rows))
        nodes = jnp.arange(count, width), theta, rows
        derivatives, _ = jax.lax.scan(evaluate, derivatives, nodes)
    fields = jnp.asarray(output.basis, h.dtype) @ derivatives
    return _Interpolant(y0, fields, rules, _algebra_scheme(table))


def _coordinates(rules: Rules, u: JaxArray, y0: JaxArray, y1: JaxArray, series: int) -> JaxArray:
    """Return the coordinates of a step, by Newton's method from ``u``."""
    log, dexpinv = rules.log, rules.dexpinv
    assert log is not None
    assert dexpinv is not None

    def improve(u: JaxArray, _: Any) -> tuple[JaxArray, None]:
        return u + dexpinv(u, log(rules.flow(u, y0), y1), series), None

    return jax.lax.scan(improve, u, None, length=_NEWTON_STEPS)[0]


@cached
def _algebra_scheme(table: MethodTable) -> _Scheme:
    """Return the polynomials of the basis, one flow."""
    degree = len(table.output.basis)
    weights = np.zeros((1, degree, degree))
    for d, p in enumerate(basis_polynomials(degree)):
        weights[0, d, : d + 1] = p.coef[1 : d + 2]
    return _Scheme(weights)


def _by_flows(table: MethodTable, start: Start, stages: Stages, at_end: JaxArray) -> _Interpolant:
    """Return the interpolant by flows; each level gives the points of nodes of the next one."""
    rules, f, h, y0 = start.rules, start.f, start.h, start.y0
    schemes = _flow_schemes(table)
    displacements = h * (jnp.asarray(table.result_flows, h.dtype) @ stages.vectors)

    def close(fields: JaxArray, scheme: _Scheme) -> _Interpolant:
        """Add the last flow, which leads to the end of the step."""
        before = _Interpolant(y0, jnp.pad(fields, ((0, 1), (0, 0))), rules, scheme)
        reached, left = before(jnp.ones((), h.dtype)), jnp.zeros_like(at_end)
        if rules.composed is not None:  # as in fortran/steps/interpolant.f90
            back = -jnp.asarray(scheme.weights.sum(2)[-2::-1, :-1], h.dtype) @ fields
            left = rules.composed(jnp.concatenate([back, displacements]))
            reached = rules.flow(left, reached)
        left = left + rules.nearby(reached, stages.result)
        return _Interpolant(y0, jnp.concatenate([fields, left[None]]), rules, scheme)

    ends = h * jnp.stack([start.at_start, at_end])
    level = close(ends, schemes[0])
    for count, scheme in enumerate(schemes[1:], 3):
        theta = jnp.asarray(table.output.node[1 : count - 1, count - 2], h.dtype)

        def evaluate(node: JaxArray, level: _Interpolant = level) -> JaxArray:
            return h * f(node, level(node))

        inner = jax.lax.map(evaluate, theta)
        level = close(jnp.concatenate([ends[:1], inner, ends[1:]]), scheme)
    return level


@cached
def _flow_schemes(table: MethodTable) -> list[_Scheme]:
    r"""Return the weights of interpolants with 2, 3, … nodes.

    A flow has weights :math:`\theta \sum_k w_k L_j(c_k \theta)` of the coefficients at nodes,
    with Lagrange's polynomials, and the last one the blend.
    """
    output = table.output
    c, flows = output.flow_c, output.flow_weights
    schemes = []
    for count in range(2, len(output.node) + 1):
        nodes = output.node[:count, count - 2]
        weights = np.zeros((len(flows) + 1, count + 1, count + 1))
        for j in range(count):
            others = np.delete(nodes, j)
            lagrange = Polynomial.fromroots(others) / np.prod(nodes[j] - others)
            for m, coefficient in enumerate(lagrange.coef):
                weights[:-1, j, m] = coefficient * (flows @ c**m)
        weights[-1, -1, :] = output.blend[1 : count + 2, count - 2]
        schemes.append(_Scheme(weights))
    return schemes
