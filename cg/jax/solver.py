"""Steps of the methods of the catalogue, for diffrax."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from cg.catalogue import resolve_method
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.integration.arguments import check_algebra
from cg.integration.step.paths import MethodPaths, paths_of
from cg.integration.step.plan import error_exponent
from cg.jax.entire import JaxArray
from cg.jax.linear import (
    Before,
    LinearTerm,
    magnus_error,
    no_step,
    node_difference,
    values_at_nodes,
)
from cg.jax.noise import check_noise, increments
from cg.jax.points import membership_error
from cg.jax.rules import Rules
from cg.jax.term import refuse_implicit_adjoint, rules_in, unwrapped
from cg.jax.within import Within, interpolant
from cg.method.magnus import MagnusMethod
from cg.method.method import Method
from cg.method.munthe_kaas import MuntheKaas
from cg.method.splitting import Splitting
from cg.support.copies import cached

_DENSE = ("accurate", "steps")


@dataclass(frozen=True, eq=False)
class _Steps:
    """The steps of a method; there is one for each method, compared by identity."""

    method: Method

    @cached_property
    def paths(self) -> MethodPaths:
        return paths_of(self.method)

    @cached_property
    def flows(self) -> list[list[NDArray[np.float64]]]:
        """The weights of the flows of each path, on the stages that are known by then."""
        return [[_row(dict(flow)) for flow in path.flows] for path in self.paths.paths]

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """Of a method of Munthe-Kaas, the weights of stages in paths and in error estimates.

        Shape ``(1 + paths + estimates, stages)``; the first row is zero and stands for the start of
        the step.
        """
        table = np.zeros((1 + len(self.flows), len(self.paths.stages)))
        for row, (flow,) in zip(table[1:], self.flows, strict=True):
            row[: len(flow)] = flow
        return np.concatenate([table, self.errors])

    @cached_property
    def on_algebra(self) -> bool:
        return isinstance(self.method, MuntheKaas)

    @cached_property
    def of_time(self) -> bool:
        return isinstance(self.method, MagnusMethod)

    @cached_property
    def errors(self) -> NDArray[np.float64]:
        """The weights of the error estimates, shape ``(0, 1 or 2, stages)``."""
        return np.array(self.paths.errors, dtype=np.float64).reshape(-1, len(self.paths.stages))


def _row(flow: dict[int, Any]) -> NDArray[np.float64]:
    row = np.zeros(max(flow, default=0) + 1)
    for stage, weight in flow.items():
        row[stage] = float(weight)
    return row


@cached
def _steps_of(method: Method) -> _Steps:
    return _Steps(method)


class Solver(diffrax.AbstractAdaptiveSolver, diffrax.AbstractStratonovichSolver):
    r"""An explicit method of the catalogue, or of the user, as a solver of `diffrax.diffeqsolve`.

    Its term is a `FrameTerm`. The error estimate of a pair is a tangent at the end of the step:
    a plain ``diffrax.PIDController`` compares it with the entries of points, and `controller`
    with coordinates, as `cg.solve_ivp` does.

    Parameters
    ----------
    method
        The name of a method, or a method.
    dense
        One of ``"accurate"``, ``"steps"``. The interpolant. ``"accurate"`` (default) is that of
        `cg.solve_ivp`, as accurate as the steps; if output between steps or an event needs it, it
        calls ``f`` some more times in every step. ``"steps"`` is exact at the ends of steps and has
        an error of second order between them, at any tolerance, which ``SaveAt(ts=...)`` and events
        would use; it calls ``f`` no more times and compiles faster.
    unroll
        Whether `XLA` compiles the stages of a Munthe-Kaas method one after the other instead of
        as a loop. The loop compiles faster and takes less time in batches by ``jax.vmap``, but a
        little more for a single solution. Stages of other methods are never a loop.

    Raises
    ------
    TypeError
        If ``method`` is neither a name nor a method, or ``unroll`` is not a bool.
    ValueError
        If no method has that name, the method is implicit or ``dense`` has another value.
    RuntimeError
        When it is used: if ``y0`` is farther from the manifold than 1e-8, or 1e-5 in single
        precision. ``EQX_ON_ERROR=off`` in the environment turns this check of `equinox` off.

    Notes
    -----
    The stored coefficients of the method are rounded to the precision of the points. Weighted
    sums of stages are products with a matrix, each one kernel of `XLA`. ``BacksolveAdjoint`` is
    refused, because its state is no point of the frame.

    Examples
    --------
    >>> import cg
    >>> cg.jax.Solver("CF7(6)")
    Solver("CF7(6)")
    """

    steps: _Steps = eqx.field(static=True)
    dense: str = eqx.field(static=True)
    unroll: bool = eqx.field(static=True)

    term_structure: ClassVar[Any] = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., Any]] = Within

    def __init__(
        self, method: str | Method, *, dense: str = "accurate", unroll: bool = False
    ) -> None:
        if isinstance(method, str) and method == "auto":
            raise ValueError(
                'method must be named in JAX, which has no "auto"; of the pairs "RKMK8(5,3)" takes '
                'the least time in the benchmarks, and "CF5(4)" needs no brackets; "CF4" is for '
                "fixed steps"
            )
        method = resolve_method(method)
        if not method.explicit:
            raise ValueError(f"method must be explicit in JAX, got {method!r}")
        if isinstance(method, Splitting):
            raise ValueError(f"method must not be a splitting method in JAX, got {method!r}")
        if dense not in _DENSE:
            raise ValueError(f'dense must be "accurate" or "steps", got {dense!r}')
        if not isinstance(unroll, bool):
            raise TypeError(f"unroll must be a bool, got {unroll!r}")
        self.steps = _steps_of(method)
        self.dense = dense
        self.unroll = unroll

    def __repr__(self) -> str:
        method = self.steps.method
        label = f'"{method.name}"' if method.name else repr(method)
        more = "" if self.dense == _DENSE[0] else f', dense="{self.dense}"'
        return f"Solver({label}{more}{', unroll=True' if self.unroll else ''})"

    @property
    def method(self) -> Method:
        """The method."""
        return self.steps.method

    def order(self, terms: Any) -> int:
        """Return the order of the method."""
        embedded = self.method.embedded_order
        return max(self.method.order, embedded or 0)

    def error_order(self, terms: Any) -> float | None:
        """Return the power of the step that the estimate is proportional to; None without one."""
        if self.method.embedded_order is None:
            return None
        return 1.0 / error_exponent(self.method)

    def strong_order(self, terms: Any) -> float:
        """Return the strong order for noise whose fields don't commute."""
        return 0.5

    def func(self, terms: Any, t0: JaxArray, y0: JaxArray, args: Any) -> JaxArray:
        """Return the coefficients at a point."""
        refuse_implicit_adjoint(rules_in(terms).frame)
        if isinstance(terms, diffrax.MultiTerm):
            return terms.terms[0].vf(t0, y0, args)
        return terms.vf(t0, y0, args)

    def init(self, terms: Any, t0: Any, t1: Any, y0: JaxArray, args: Any) -> Any:
        """Return the coefficients at the start, after checking the term and the point.

        Those of a Magnus method come with the step before.
        """
        frame = rules_in(terms).frame
        if self.steps.on_algebra:
            check_algebra(frame, self.method)
        if self.steps.of_time and not isinstance(unwrapped(terms), LinearTerm):
            raise ValueError(
                f"method must be for nonlinear equations, got {self.method!r}; those of time alone "
                "are a cg.jax.LinearTerm"
            )
        if isinstance(terms, diffrax.MultiTerm):
            check_noise(terms, self.method)
        first = self.func(terms, t0, y0, args)
        tolerance = max(MEMBERSHIP_TOLERANCE, 100.0 * float(jnp.finfo(y0.dtype).eps))
        first = eqx.error_if(
            first,
            ~(membership_error(frame, y0) <= tolerance),
            f"y0 must be within {tolerance:.1g} of the manifold of {frame!r}; frame.project(y0) "
            "returns the nearest point",
        )
        return (first, no_step(self.steps.paths, first)) if self.steps.of_time else first

    def step(
        self,
        terms: Any,
        t0: JaxArray,
        t1: JaxArray,
        y0: JaxArray,
        args: Any,
        solver_state: Any,
        made_jump: Any,
    ) -> tuple[Any, ...]:
        """Return the point after a step, its error, and what else diffrax wants of it."""
        y1, error, within, last = _step(self, terms, t0, t1, y0, args, solver_state, made_jump)
        return y1, error, {"within": within}, last, diffrax.RESULTS.successful


@dataclass(frozen=True)
class _Stages:
    """What a step has computed at its stages.

    ``values`` are the coefficients at the stages, shape ``(stages, dim)``, of a method of
    Munthe-Kaas the derivatives of coordinates; ``last`` those at the result, None if no stage is
    there. ``embedded`` and ``third`` are further results, None where no pair compares points.
    ``errors`` are weighted sums of the values, further error estimates divided by the step, shape
    ``(0, 1 or 2, dim)``.
    """

    values: JaxArray
    result: JaxArray
    embedded: JaxArray | None
    errors: JaxArray
    last: JaxArray | None
    third: JaxArray | None = None


@eqx.filter_jit  # diffrax calls a step three times, twice for the types of what it returns
def _step(
    solver: Solver,
    terms: Any,
    t0: JaxArray,
    t1: JaxArray,
    y0: JaxArray,
    args: Any,
    state: Any,
    made_jump: Any,
) -> tuple[JaxArray, JaxArray | None, Any, Any]:
    """Return the point after a step, its error, the interpolant and the next state."""
    rules, steps = rules_in(terms), solver.steps
    if isinstance(terms, diffrax.MultiTerm):
        return _noisy_step(solver, rules, increments(terms, t0, t1, args), y0, state)
    first, before = state if steps.of_time else (state, None)
    h = jnp.asarray(terms.contr(t0, t1), first.dtype)

    def f(c: Any, y: JaxArray) -> JaxArray:
        return terms.vf(t0 + c * (t1 - t0), y, args)

    if made_jump is not False:
        first = jax.lax.cond(made_jump, lambda: f(0.0, y0), lambda: first)
        if before is not None:
            before = Before(jnp.where(made_jump, 0.0, before.h), before.values)
    if steps.on_algebra:
        stages = _take_stages_on_algebra(steps, rules, f, h, y0, first, solver.unroll)
    else:
        stages = _take_stages(steps, rules, f, h, y0, first)
    y1, values = stages.result, stages.values
    last = f(1.0, y1) if stages.last is None else stages.last
    within = interpolant(
        solver.method, rules, f, h, y0, y1, first, last, values, accurate=solver.dense == _DENSE[0]
    )
    if before is None:
        return y1, _error(steps, rules, h, y0, stages), within, last
    return (
        y1,
        _error_of_time(steps, rules, h, y0, stages, before),
        within,
        (last, Before(h, values)),
    )


def _noisy_step(
    solver: Solver, rules: Rules, f: Callable[[Any, JaxArray], JaxArray], y0: JaxArray, state: Any
) -> tuple[JaxArray, None, Any, Any]:
    """Take a step of size one along increments; there is no error estimate."""
    steps, one = solver.steps, jnp.ones((), state.dtype)
    first = f(0.0, y0)
    if steps.on_algebra:
        stages = _take_stages_on_algebra(steps, rules, f, one, y0, first, solver.unroll)
    else:
        stages = _take_stages(steps, rules, f, one, y0, first)
    within = interpolant(
        solver.method, rules, f, one, y0, stages.result, first, first, stages.values, accurate=False
    )
    return stages.result, None, within, state


def _error_of_time(
    steps: _Steps, rules: Rules, h: JaxArray, y0: JaxArray, stages: _Stages, before: Before
) -> JaxArray | None:
    """Return the estimate of a Magnus method as a tangent; None without a pair."""
    if stages.embedded is None:
        return None
    others = [stages.embedded, *([] if stages.third is None else [stages.third])]
    unseen = node_difference(steps.paths, stages.values, h, before)
    return magnus_error(steps.paths, rules, y0, stages.result, others, unseen)


def _take_stages(
    steps: _Steps,
    rules: Rules,
    f: Callable[[Any, JaxArray], JaxArray],
    h: JaxArray,
    y0: JaxArray,
    first: JaxArray,
) -> _Stages:
    """Return the stages and results of a method whose stages are reached by compositions."""
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
        stages = list(values_at_nodes(paths, f, y0, h.dtype))
        last = stages[-1] if paths.abscissae[-1] == 1.0 else None
    for c, k in zip(paths.abscissae.tolist()[len(stages) :], paths.stages, strict=False):
        follow(k)
        value = first if k == 0 and c == 0.0 and not stages else f(c, ends[k])
        if len(stages) + 1 == paths.final_stage:
            last = value
        stages.append(value)
    follow(len(paths.paths))
    embedded = ends[paths.embedded] if paths.embedded else None
    values = jnp.stack(stages)
    errors = jnp.asarray(steps.errors, h.dtype) @ values
    third = ends[paths.third] if paths.third else None
    return _Stages(values, ends[paths.result], embedded, errors, last, third)


def _take_stages_on_algebra(
    steps: _Steps,
    rules: Rules,
    f: Callable[[Any, JaxArray], JaxArray],
    h: JaxArray,
    y0: JaxArray,
    first: JaxArray,
    unroll: bool,
) -> _Stages:
    """Return the stages and the result of a method of Munthe-Kaas.

    Each path is one flow from the start, whose coordinates are a weighted sum of stages. The
    value at a stage is added to the sums of all paths at once, which is one kernel of XLA in
    either mode of differentiation. JAX traces and differentiates one stage of the loop, also
    where XLA compiles it unrolled. Reverse mode computes flows and dexpinv again, in fewer
    kernels than it takes to store what their derivatives need.
    """
    paths = steps.paths
    weights = jnp.asarray(steps.weights, h.dtype)
    nodes = jnp.asarray(paths.abscissae, h.dtype)
    numbers = jnp.asarray(paths.stages)
    assert rules.dexpinv is not None
    flow = jax.checkpoint(rules.flow, prevent_cse=False)
    dexpinv = jax.checkpoint(rules.dexpinv, prevent_cse=False, static_argnums=2)

    def added(sums: JaxArray, column: JaxArray, value: JaxArray) -> JaxArray:
        return sums + column[:, None] * value

    def take(sums: JaxArray, stage: Any) -> tuple[JaxArray, JaxArray]:
        path, c, column = stage
        u = h * sums[path]
        value = dexpinv(u, f(c, flow(u, y0)), paths.series)
        return added(sums, column, value), value

    def loop(sums: JaxArray, begin: int, end: int) -> tuple[JaxArray, JaxArray]:
        rows = numbers[begin:end], nodes[begin:end], weights.T[begin:end]
        sums, values = jax.lax.scan(take, sums, rows, unroll=unroll)
        return sums, values

    count = len(paths.stages)
    final = paths.final_stage - 1 if paths.final_stage else count
    sums, values = loop(weights[:, :1] * first, 1, final)
    values = [first[None], values]
    u = h * sums[paths.result]
    result = rules.restore(rules.flow(u, y0))
    last = None
    if final < count:
        last = f(1.0, result)
        value = dexpinv(u, last, paths.series)
        sums = added(sums, weights[:, final], value)
        values.append(value[None])
    if final + 1 < count:
        sums, after = loop(sums, final + 1, count)
        values.append(after)
    errors = sums[len(steps.flows) + 1 :]
    return _Stages(jnp.concatenate(values), result, None, errors, last)


def _combined(h: JaxArray, row: NDArray[np.float64], stages: list[JaxArray]) -> JaxArray:
    """Return h times a weighted sum of coefficients at stages, as one product."""
    used = np.flatnonzero(row)
    if len(used) == 1:
        return (h * float(row[used[0]])) * stages[used[0]]
    return (h * jnp.asarray(row[used], h.dtype)) @ jnp.stack([stages[k] for k in used])


def _error(
    steps: _Steps,
    rules: Rules,
    h: JaxArray,
    y0: JaxArray,
    stages: _Stages,
) -> JaxArray | None:
    """Return the estimate as a tangent at the end of the step; None without a pair.

    Two estimates are made one as in DOP853, or the larger one counts, by norms that are those of
    `controller` where both of its tolerances are equal.
    """
    y1, other = stages.result, stages.embedded
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
        size = rules.extent(y0, y1)
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


def _larger(error: JaxArray, at_end: JaxArray, steps: _Steps, squares: list[JaxArray]) -> JaxArray:
    """Return the error, or that at the end of the step if it is larger, see `end_weights`."""
    end = squares[1]
    if len(squares) > 2:
        share = end / jnp.maximum(end + squares[2], jnp.finfo(end.dtype).tiny)
        end, at_end = end * share, jax.lax.stop_gradient(jnp.sqrt(share)) * at_end
    return jnp.where(float(steps.paths.factor) ** 2 * end > squares[0], at_end, error)
