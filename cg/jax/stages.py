"""Stages of a step: coefficients along the paths of a method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from cg.jax.entire import JaxArray
from cg.jax.rules import Rules, linear
from cg.method.magnus import MagnusMethod
from cg.method.method import Method
from cg.method.munthe_kaas import MuntheKaas
from cg.method.paths import MethodPaths, paths_of


@dataclass(frozen=True, eq=False)
class Steps:
    """A method with the tables of its steps.

    JAX compares it by identity; `steps_of` returns one object for equal methods.
    """

    method: Method

    def __reduce__(self) -> tuple[Any, ...]:
        return steps_of, (self.method,)

    @cached_property
    def paths(self) -> MethodPaths:
        """The paths of the method."""
        return paths_of(self.method)

    @cached_property
    def flows(self) -> list[NDArray[np.float64]]:
        """The weights of stages in the flows of each path, shape ``(flows, stages)``."""
        return [flow_weights(path.flows, self.paths) for path in self.paths.paths]

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """Of a method of Munthe-Kaas, the weights of stages in paths and in error estimates.

        Shape ``(1 + paths + estimates, stages)``; the first row is zero and stands for the start of
        the step.
        """
        return np.concatenate([np.zeros((1, len(self.paths.stages))), *self.flows, self.errors])

    @cached_property
    def on_algebra(self) -> bool:
        """Whether the method is one of Munthe-Kaas."""
        return isinstance(self.method, MuntheKaas)

    @cached_property
    def of_time(self) -> bool:
        """Whether the method is one of Magnus."""
        return isinstance(self.method, MagnusMethod)

    @cached_property
    def errors(self) -> NDArray[np.float64]:
        """The weights of the error estimates, shape ``(0, 1 or 2, stages)``."""
        columns = len(self.paths.stages) + len(self.paths.brackets)
        return np.array(self.paths.errors, dtype=np.float64).reshape(-1, columns)


def flow_weights(flows: Any, paths: MethodPaths) -> NDArray[np.float64]:
    """Return the weights of stages and brackets in flows, shape ``(flows, stages + brackets)``."""
    weights = np.zeros((len(flows), len(paths.stages) + len(paths.brackets)))
    for row, flow in zip(weights, flows, strict=True):
        for stage, weight in flow:
            row[stage] = float(weight)
    return weights


@lru_cache(maxsize=256)
def steps_of(method: Method) -> Steps:
    """Return the tables of a method."""
    return Steps(method)


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
    weighted sums of the values, further error estimates divided by the step, shape ``(0, 1 or 2,
    dim)``. ``columns`` are the values and the brackets of a Magnus method, which flows combine.
    """

    values: JaxArray
    result: JaxArray
    others: list[JaxArray]
    errors: JaxArray
    last: JaxArray | None
    columns: JaxArray


def take_stages(steps: Steps, start: Start, *, unroll: bool) -> Stages:
    """Return the stages and results of a method."""
    if steps.on_algebra:
        return _take_stages_on_algebra(steps, start, unroll)
    rules, f, h, y0, first = start.rules, start.f, start.h, start.y0, start.first
    paths = steps.paths
    last = None
    stages: list[JaxArray] = []
    ends = [y0]
    results = {paths.result, paths.embedded, paths.third}

    def follow(last: int) -> None:
        for k in range(len(ends), last + 1):
            y = ends[paths.paths[k - 1].origin]
            for row in steps.flows[k - 1]:
                # Without the barrier XLA compiles a flow once for each of its consumers. Then
                # rounding errors, and with them sizes of steps, differ between the forward pass
                # and its repetition by an adjoint.
                y = jax.lax.optimization_barrier(rules.flow(_combined(h, row, stages), y))
            ends.append(rules.restore(y) if k in results else y)

    if steps.of_time:
        stages = list(jax.vmap(lambda c: f(c, y0))(jnp.asarray(paths.abscissae, h.dtype)))
        last = stages[-1] if paths.abscissae[-1] == 1.0 else None
        for pair in paths.brackets:
            u, v = (_combined(h, np.array(row, np.float64), stages) for row in pair)
            stages.append(v @ linear(u, rules.frame._adjoint_basis) / h)
    for c, k in zip(paths.abscissae.tolist()[len(stages) :], paths.stages, strict=False):
        follow(k)
        value = first if k == 0 and c == 0.0 and not stages else f(c, ends[k])
        if len(stages) + 1 == paths.final_stage:
            last = value
        stages.append(value)
    follow(len(paths.paths))
    others = [ends[k] for k in (paths.embedded, paths.third) if k]
    columns = jnp.stack(stages)
    errors = jnp.asarray(steps.errors, h.dtype) @ columns
    values = columns[: len(paths.stages)]
    return Stages(values, ends[paths.result], others, errors, last, columns)


def _take_stages_on_algebra(steps: Steps, start: Start, unroll: bool) -> Stages:
    """Return the stages and the result of a method of Munthe-Kaas.

    Each path is one flow from the start, whose coordinates u are h times a weighted sum of the
    values k = dexpinv(u, f). The value at a stage is added to the sums of all paths at once, one
    kernel of XLA in either mode of differentiation. Reverse mode computes flows and dexpinv
    again, in fewer kernels than it takes to store what their derivatives need.
    """
    paths, rules, f, h, y0 = steps.paths, start.rules, start.f, start.h, start.y0
    weights = jnp.asarray(steps.weights, h.dtype)
    nodes = jnp.asarray(paths.abscissae, h.dtype)
    numbers = jnp.asarray(paths.stages)
    assert rules.dexpinv is not None
    flow = jax.checkpoint(rules.flow, prevent_cse=False)
    dexpinv = jax.checkpoint(rules.dexpinv, prevent_cse=False, static_argnums=2)

    def take(sums: JaxArray, stage: Any) -> tuple[JaxArray, JaxArray]:
        path, c, column = stage
        u = h * sums[path]
        value = dexpinv(u, f(c, flow(u, y0)), paths.series)
        return sums + column[:, None] * value, value

    def loop(sums: JaxArray, begin: int, end: int) -> tuple[JaxArray, JaxArray]:
        rows = numbers[begin:end], nodes[begin:end], weights.T[begin:end]
        scanned: tuple[JaxArray, JaxArray] = jax.lax.scan(take, sums, rows, unroll=unroll)
        return scanned

    count = len(paths.stages)
    final = paths.final_stage - 1 if paths.final_stage else count
    sums, values = loop(weights[:, :1] * start.first, 1, final)
    values = [start.first[None], values]
    u = h * sums[paths.result]
    result = rules.restore(rules.flow(u, y0))
    last = None
    if final < count:
        last = f(1.0, result)
        value = dexpinv(u, last, paths.series)
        sums = sums + weights[:, final, None] * value
        values.append(value[None])
    if final + 1 < count:
        sums, after = loop(sums, final + 1, count)
        values.append(after)
    errors = sums[len(steps.flows) + 1 :]
    columns = jnp.concatenate(values)
    return Stages(columns, result, [], errors, last, columns)


def _combined(h: JaxArray, row: NDArray[np.float64], stages: list[JaxArray]) -> JaxArray:
    """Return h times a weighted sum of coefficients at stages, as one product."""
    used = np.flatnonzero(row)
    if len(used) == 1:
        return (h * float(row[used[0]])) * stages[used[0]]
    return (h * jnp.asarray(row[used], h.dtype)) @ jnp.stack([stages[k] for k in used])
