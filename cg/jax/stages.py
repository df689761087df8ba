"""Stages of a step: coefficients along the paths of a method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from cg.jax.entire import JaxArray
from cg.jax.rules import Rules, linear
from cg.tables import Kind, MethodTable


@dataclass(frozen=True)
class Start:
    """The start of a step: its point, the coefficients there, its size.

    ``f(c, y)`` returns the coefficients at a point and a fraction of the step.
    """

    rules: Rules
    f: Callable[[Any, JaxArray], JaxArray]
    h: JaxArray
    y0: JaxArray
    first: JaxArray


@dataclass(frozen=True)
class Stages:
    """What a step has computed at its stages.

    ``values`` are the coefficients at the stages, shape ``(stages, dim)``, of a method of
    Munthe-Kaas the derivatives of coordinates; ``last`` those at the result, None if no stage is
    there. ``others`` are the results with which a pair compares the first one. ``errors`` are
    weighted sums of the values, further error estimates divided by the step, shape ``(sums, dim)``;
    on the algebra, if there are several, all sums of coefficients, and then all sums of what
    dexpinv has added to them. ``columns`` are the values and the brackets of a Magnus method,
    which flows combine.
    """

    values: JaxArray
    result: JaxArray
    others: list[JaxArray]
    errors: JaxArray
    last: JaxArray | None
    columns: JaxArray


def take_stages(table: MethodTable, start: Start, *, unroll: bool) -> Stages:
    """Return the stages and results of a method."""
    if table.on_algebra:
        return _take_stages_on_algebra(table, start, unroll)
    rules, f, h, y0, first = start.rules, start.f, start.h, start.y0, start.first
    record, c = table.record, table.c
    last = None
    stages: list[JaxArray] = []
    ends = [y0]
    results = {record.result, record.embedded, record.third}

    def follow(last: int) -> None:
        for k in range(len(ends), last + 1):
            origin, flows = table.paths[k - 1]
            y = ends[origin]
            for row in flows:
                # Without the barrier XLA compiles a flow once for each of its consumers. Then
                # rounding errors, and with them sizes of steps, differ between the forward pass
                # and its repetition by an adjoint.
                y = jax.lax.optimization_barrier(rules.flow(_combined(h, row, stages), y))
            ends.append(rules.restore(y) if k in results else y)

    if table.kind is Kind.LINEAR:
        stages = list(jax.vmap(lambda at: f(at, y0))(jnp.asarray(c, h.dtype)))
        last = stages[-1] if c[-1] == 1.0 else None
        for pair in table.brackets:
            u, v = (_combined(h, row, stages) for row in pair)
            stages.append(v @ linear(u, rules.frame._adjoint_basis) / h)
    places = table.arrays["stage_path"].tolist()
    for at, k in zip(c.tolist()[len(stages) :], places, strict=False):
        follow(k)
        value = first if k == 0 and at == 0.0 and not stages else f(at, ends[k])
        if len(stages) + 1 == record.final_stage:
            last = value
        stages.append(value)
    follow(len(table.paths))
    others = [ends[k] for k in (record.embedded, record.third) if k]
    columns = jnp.stack(stages)
    errors = jnp.asarray(table.errors, h.dtype) @ columns
    values = columns[: len(c)]
    return Stages(values, ends[record.result], others, errors, last, columns)


def _take_stages_on_algebra(table: MethodTable, start: Start, unroll: bool) -> Stages:
    """Return the stages and the result of a method of Munthe-Kaas.

    Each path is one flow from the start, whose coordinates u are h times a weighted sum of the
    values k = dexpinv(u, f). The value at a stage is added to the sums of all paths at once, one
    kernel of XLA in either mode of differentiation. Reverse mode computes flows and dexpinv
    again, in fewer kernels than it takes to store what their derivatives need.
    """
    record, rules, f, h, y0 = table.record, start.rules, start.f, start.h, start.y0
    # weights of stages in paths and in error estimates, after the start of the step
    rows = [np.zeros((1, table.columns)), *(flows for _, flows in table.paths), table.errors]
    weights = jnp.asarray(np.concatenate(rows), h.dtype)
    nodes = jnp.asarray(table.c, h.dtype)
    numbers = jnp.asarray(table.arrays["stage_path"])
    assert rules.dexpinv is not None
    flow = jax.checkpoint(rules.flow, prevent_cse=False)
    dexpinv = jax.checkpoint(rules.dexpinv, prevent_cse=False, static_argnums=2)

    in_parts = len(table.errors) > 1

    def take(sums: JaxArray, stage: Any) -> tuple[JaxArray, tuple[JaxArray, JaxArray | None]]:
        path, c, column = stage
        u = h * sums[path]
        coefficients = f(c, flow(u, y0))
        value = dexpinv(u, coefficients, record.series)
        added = value - coefficients if in_parts else None
        return sums + column[:, None] * value, (value, added)

    def loop(sums: JaxArray, begin: int, end: int) -> JaxArray:
        rows = numbers[begin:end], nodes[begin:end], weights.T[begin:end]
        sums, (value, added) = jax.lax.scan(take, sums, rows, unroll=unroll)
        values.append(value)
        if in_parts:
            rest.append(added)
        return sums

    count = len(table.c)
    final = record.final_stage - 1 if record.final_stage else count
    values = [start.first[None]]
    rest = [jnp.zeros_like(start.first)[None]] if in_parts else []
    sums = loop(weights[:, :1] * start.first, 1, final)
    u = h * sums[record.result]
    result = rules.restore(rules.flow(u, y0))
    last = None
    if final < count:
        last = f(1.0, result)
        value = dexpinv(u, last, record.series)
        sums = sums + weights[:, final, None] * value
        values.append(value[None])
        if in_parts:
            rest.append((value - last)[None])
    if final + 1 < count:
        sums = loop(sums, final + 1, count)
    errors = sums[len(table.paths) + 1 :]
    if in_parts:
        of_rest = weights[len(table.paths) + 1 :] @ jnp.concatenate(rest)
        errors = jnp.concatenate([errors - of_rest, of_rest])
    columns = jnp.concatenate(values)
    return Stages(columns, result, [], errors, last, columns)


def _combined(h: JaxArray, row: NDArray[np.float64], stages: list[JaxArray]) -> JaxArray:
    """Return h times a weighted sum of coefficients at stages, as one product."""
    used = np.flatnonzero(row)
    if len(used) == 1:
        return (h * float(row[used[0]])) * stages[used[0]]
    return (h * jnp.asarray(row[used], h.dtype)) @ jnp.stack([stages[k] for k in used])
