"""Stages of a step, as paths of flows or in a Lie algebra, and interpolants between steps.

`cg.construction.methods.paths` explains paths, `cg.construction.methods.interpolant` interpolants.
"""

from __future__ import annotations

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
from cg.support.caches import cached_by_identity
from cg.support.checks import warn_user
from cg.support.shared_numbers import EstimateForm
from cg.tables import Kind, MethodTable, basis_polynomials

_NEWTON_STEPS = 3  # each squares an error that is of third order at first
_TANGENT_ORDER = 16  # order of the series of dexpinv in derivatives, which no iteration corrects


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
    other_results: list[JaxArray]  # second and third results, with which the result is compared
    errors: JaxArray  # (sums, dim) weighted sums of values: error estimates divided by the step
    at_end: JaxArray | None  # coefficients at the result, None if no stage is there
    vectors: JaxArray  # values, then brackets of a Magnus method or values at nodes of output


def take_stages(
    table: MethodTable, start: Start, *, unroll: bool, with_end: bool, between: bool
) -> Stages:
    """Return stages and results, from a loop by which XLA compiles ``f`` and flow once.

    If ``with_end``, ``f`` is evaluated at the end of the step, too, and by methods on the algebra
    if ``between`` at the nodes of output.
    """
    if table.on_algebra:
        return _take_stages_on_algebra(table, start, unroll, with_end, between)
    return _take_stages_by_flows(table, start, unroll, with_end)


@dataclass(frozen=True, eq=False)
class _Flows:
    """The flows of a step: flow k leads from the point ``origins[k]`` to point ``k + 1``.

    Point 0 is the start. ``ends`` are the points at the ends of the paths of a table, ``stages``
    those of its stages; ``weights`` has the shape ``(flows, vectors)``.
    """

    origins: list[int]
    weights: Array
    ends: list[int]
    stages: list[int]


@cached_by_identity
def _flows_of(table: MethodTable) -> _Flows:
    origins: list[int] = []
    ends, width = [0], table.errors.shape[1]
    for origin, rows in table.paths:
        for k in range(len(rows)):
            origins.append(len(origins) if k else ends[origin])
        ends.append(len(origins))
    weights = [np.pad(row, (0, width - len(row))) for _, rows in table.paths for row in rows]
    stages = [ends[path] for path in table.arrays["stage_path"].tolist()]
    return _Flows(origins, np.array(weights), ends, stages)


def _take_stages_by_flows(table: MethodTable, start: Start, unroll: bool, with_end: bool) -> Stages:
    """Return the stages and the results of a method whose paths are flows.

    A flow has h times a weighted sum of values as coefficients. The value of ``f`` at a stage is
    added to the sums of all flows at once.
    """
    rules, f, h, y0 = start.rules, start.f, start.h, start.y0
    record, flows = table.record, _flows_of(table)
    count, result = len(flows.origins), flows.ends[record.result]
    times: dict[int, float] = {}  # abscissae of the points at which f is evaluated
    columns = np.zeros((count + 1, count))  # weights of the values at points
    if table.kind is Kind.LINEAR:
        vectors = _vectors_of_time(table, start)
        sums = jnp.asarray(flows.weights, h.dtype) @ vectors
    else:
        abscissae = dict(zip(flows.stages, table.c.tolist(), strict=True))
        times = ({result: 1.0} if with_end else {}) | abscissae
        np.add.at(columns, flows.stages, flows.weights.T)
        first = start.at_start if times[0] == 0.0 else f(times[0], y0)
        sums = jnp.asarray(columns[0, :, None], h.dtype) * first
    flow = jax.checkpoint(rules.flow, prevent_cse=False)

    def take(carry: tuple[JaxArray, JaxArray], step: Any) -> Any:
        points, sums = carry
        k, origin, c, is_evaluated, column = step
        # Without the barrier XLA compiles a flow once for each of its consumers. Then rounding
        # errors, and with them sizes of steps, differ between the forward pass and its repetition
        # by an adjoint.
        y = jax.lax.optimization_barrier(flow(h * sums[k], points[origin]))
        points = points.at[k + 1].set(y)
        if not times:
            return (points, sums), None
        value = jax.lax.cond(is_evaluated, lambda: f(c, y), lambda: jnp.zeros_like(first))
        # the results don't depend on f at the end of the step, which may be infinite
        added = jnp.where(column[:, None] == 0.0, 0.0, column[:, None] * value)
        return (points, sums + added), value

    points = jnp.zeros((count + 1, *y0.shape), y0.dtype).at[0].set(y0)
    reached = range(1, count + 1)
    steps = (
        np.arange(count), np.array(flows.origins), np.array([times.get(k, 0.0) for k in reached]),
        np.array([k in times for k in reached]), columns[1:],
    )  # fmt: skip
    xs = [jnp.asarray(x, h.dtype if x.dtype.kind == "f" else None) for x in steps]
    (points, _), values = jax.lax.scan(take, (points, sums), xs, unroll=unroll)
    if times:
        values = jnp.concatenate([first[None], values])
        vectors = values[np.array(flows.stages)]
        at_end = values[result] if result in times else None
    else:
        at_end = vectors[len(table.c) - 1] if table.c[-1] == 1.0 else None
    errors = jnp.asarray(table.errors, h.dtype) @ vectors
    results = (record.result, record.embedded, record.third)
    y1, *other_results = (rules.restore(points[flows.ends[k]]) for k in results if k)
    return Stages(vectors[: len(table.c)], y1, other_results, errors, at_end, vectors)


def _vectors_of_time(table: MethodTable, start: Start) -> JaxArray:
    """Return the values of ``f`` of a linear equation, then brackets of weighted sums of them."""
    h, frame = start.h, start.rules.frame
    vectors = jax.vmap(lambda c: start.f(c, start.y0))(jnp.asarray(table.c, h.dtype))
    count = len(vectors)
    vectors = jnp.pad(vectors, ((0, len(table.brackets)), (0, 0)))
    for k, pair in enumerate(jnp.asarray(table.brackets, h.dtype), count):
        u, v = pair @ vectors
        vectors = vectors.at[k].set(h * v @ linear(u, frame._adjoint_basis))
    return vectors


def _take_stages_on_algebra(
    table: MethodTable, start: Start, unroll: bool, with_end: bool, between: bool
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
    evaluations = max(output.final, count) if with_end else count
    if between and not unroll:
        evaluations = width

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
    if between and unroll:
        _, (_, more, _) = loop(sums, slice(evaluations, width), unroll=False)
        vectors = jnp.concatenate([vectors, more])
    if in_parts:  # the correction at the first stage is zero
        corrected = jnp.asarray(table.errors[:, 1:], h.dtype) @ corrections[: count - 1]
        errors = jnp.concatenate([errors - corrected, corrected])
    return Stages(values, result, [], errors, at_end, vectors)


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
    within: _Interpolant | None  # None where no point between the ends is asked for

    def evaluate(self, t0: Any, t1: Any = None, left: bool = True) -> JaxArray:
        """Return the point at a time, or the difference of those at two times."""
        assert self.within is not None
        if not self.within.scheme.accurate:
            warn_user(
                "with noise, output and events between the ends of steps have errors of order ½; "
                "end steps at such times, with diffrax.StepTo"
            )
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        span = self.t1 - self.t0
        empty = span == 0.0
        theta = jnp.where(empty, 0.0, (t0 - self.t0) / jnp.where(empty, 1.0, span))
        return self.within(theta)


def interpolant(table: MethodTable, start: Start, stages: Stages, at_end: JaxArray) -> _Interpolant:
    """Return the interpolant of a step; ``at_end`` are the coefficients at its end."""
    rules = start.rules
    if table.on_algebra or (rules.unique and rules.dexpinv is not None and rules.log is not None):
        return _on_algebra(table, start, stages, at_end)
    return _by_flows(table, start, stages, at_end)


def interpolant_of_noise(table: MethodTable, start: Start, stages: Stages) -> _Interpolant:
    """Return the flows of a step with weights proportional to time."""
    fields = start.h * stages.vectors[: table.combined_vectors]
    return _Interpolant(start.y0, fields, start.rules, _noise_scheme(table))


@cached_by_identity
def _noise_scheme(table: MethodTable) -> _Scheme:
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
        width = output.basis.shape[1]
        derivatives = jnp.pad(jnp.stack([h * start.at_start, u]), ((0, width - 2), (0, 0)))

        def evaluate(k: JaxArray, node: Any) -> tuple[JaxArray, None]:
            at, theta, row = node
            u = row @ k
            value = jax.lax.cond(at == 2, lambda: at_end, lambda: f(theta, flow(u, y0)))
            return k.at[at].set(dexpinv(u, h * value, series)), None

        # the first node is the end of the step, whose coordinates are u
        theta = jnp.asarray([1.0, *output.theta], h.dtype)
        rows = jnp.asarray(np.vstack([np.eye(width)[1], output.rows]), h.dtype)
        derivatives, _ = jax.lax.scan(evaluate, derivatives, (jnp.arange(2, width), theta, rows))
    fields = jnp.asarray(output.basis, h.dtype) @ derivatives
    return _Interpolant(y0, fields, rules, _algebra_scheme(table))


def _coordinates(rules: Rules, u: JaxArray, y0: JaxArray, y1: JaxArray, series: int) -> JaxArray:
    """Return the coordinates of a step, by Newton's method from ``u``.

    Their derivatives are those of the equation that they solve, not of its iterations.
    """
    log, dexpinv = rules.log, rules.dexpinv
    assert log is not None
    assert dexpinv is not None

    @jax.custom_jvp
    def solve(u: JaxArray, y0: JaxArray, y1: JaxArray) -> JaxArray:
        def improve(_: Any, u: JaxArray) -> JaxArray:
            return u + dexpinv(u, log(rules.flow(u, y0), y1), series)

        return jax.lax.fori_loop(0, _NEWTON_STEPS, improve, u)

    @solve.defjvp
    def _(points: Any, tangents: Any) -> tuple[JaxArray, JaxArray]:
        u, (_, y0, y1), (_, dy0, dy1) = solve(*points), points, tangents
        moved = jax.jvp(lambda y: rules.flow(u, y), (y0,), (dy0,))[1]
        v = rules.coefficients(y1, dy1 - moved)
        # linear in v, though dexpinv asks whether u and v commute
        return u, jax.jvp(lambda v: dexpinv(u, v, _TANGENT_ORDER), (u,), (v,))[1]

    return solve(u, y0, y1)


@cached_by_identity
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
        left = left + rules.local_coordinates(reached, stages.result)
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


@cached_by_identity
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
