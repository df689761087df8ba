"""The solution between the ends of a step: `cg.method.interpolant` in JAX."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from cg.jax.entire import JaxArray
from cg.jax.rules import Rules
from cg.jax.stages import Stages, Start, flow_weights
from cg.method.interpolant import (
    basis_polynomials,
    extension_of,
    flows_within,
    node_count,
    nodes_of,
    series_order,
)
from cg.method.method import Method
from cg.method.munthe_kaas import MuntheKaas
from cg.method.paths import paths_of
from cg.support.copies import cached

_ITERATIONS = 3  # of Newton's method; each squares the error, which is of third order first


@dataclass(frozen=True, eq=False)
class _Scheme:
    """Weights of flows as polynomials, and whether the interpolant is as accurate as the step.

    ``weights`` are those of θ, θ², …, shape ``(flows, coefficients, degree)``.
    """

    weights: NDArray[np.float64]
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

        def move(y: JaxArray, v: JaxArray) -> tuple[JaxArray, None]:
            return self.rules.flow(v, y), None

        return jax.lax.scan(move, self.y0, vectors)[0]


class Within(diffrax.AbstractLocalInterpolation):
    """The solution within one step, as diffrax asks for it."""

    t0: Any
    t1: Any
    within: _Interpolant

    def evaluate(self, t0: Any, t1: Any = None, left: bool = True) -> JaxArray:
        """Return the point at a time, or the difference of those at two times."""
        if not self.within.scheme.accurate:
            warnings.warn(
                'dense="steps" has errors of second order in the step between the ends of steps; '
                "output and events there need a solver without it",
                stacklevel=2,
            )
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        span = self.t1 - self.t0
        empty = span == 0.0
        theta = jnp.where(empty, 0.0, (t0 - self.t0) / jnp.where(empty, 1.0, span))
        return self.within(theta)


def interpolant(
    method: Method, start: Start, stages: Stages, last: JaxArray, *, accurate: bool
) -> _Interpolant:
    """Return the interpolant of a step; ``last`` are the coefficients at its end.

    If not ``accurate``, it consists of the flows of the step, with weights proportional to time.
    """
    rules = start.rules
    if not accurate:
        return _Interpolant(start.y0, start.h * stages.columns, rules, _straight(method))
    flat = isinstance(method, MuntheKaas)
    if flat or (rules.unique and rules.dexpinv is not None and rules.log is not None):
        return _on_algebra(method, start, stages, last)
    return _by_flows(method, start, stages.result, last)


@cached
def _straight(method: Method) -> _Scheme:
    paths = paths_of(method)
    return _Scheme(flow_weights(paths.result_flows, paths)[..., None], accurate=False)


def _on_algebra(method: Method, start: Start, stages: Stages, last: JaxArray) -> _Interpolant:
    rules, f, h, y0 = start.rules, start.f, start.h, start.y0
    extension, series = extension_of(method), series_order(method)
    dexpinv = rules.dexpinv
    assert dexpinv is not None
    # all derivatives are times h, which may be zero
    if isinstance(method, MuntheKaas):
        known = h * stages.values
        if extension.final == len(known):
            u = jnp.asarray(extension.basis[0, : len(known)], h.dtype) @ known
            known = jnp.concatenate([known, dexpinv(u, h * last, series)[None]])
    else:
        u = _coordinates(rules, 0.5 * h * (start.first + last), y0, stages.result, series)
        known = jnp.stack([h * start.first, u, dexpinv(u, h * last, series)])
    count, width = len(known), extension.basis.shape[1]
    derivatives = jnp.pad(known, ((0, width - count), (0, 0)))
    if len(extension.theta):

        def evaluate(k: JaxArray, node: Any) -> tuple[JaxArray, None]:
            at, theta, row = node
            u = row @ k
            value = dexpinv(u, h * f(theta, rules.flow(u, y0)), series)
            return k.at[at].set(value), None

        nodes = (
            jnp.arange(count, width),
            jnp.asarray(extension.theta, h.dtype),
            jnp.asarray(extension.rows, h.dtype),
        )
        derivatives, _ = jax.lax.scan(evaluate, derivatives, nodes)
    scheme = _algebra_scheme(method)
    fields = jnp.asarray(extension.basis, h.dtype) @ derivatives
    return _Interpolant(y0, fields, rules, scheme)


def _coordinates(rules: Rules, u: JaxArray, y0: JaxArray, y1: JaxArray, series: int) -> JaxArray:
    """Return the coordinates of a step, by Newton's method from ``u``."""
    log, dexpinv = rules.log, rules.dexpinv
    assert log is not None
    assert dexpinv is not None

    def improve(u: JaxArray, _: Any) -> tuple[JaxArray, None]:
        return u + dexpinv(u, log(rules.flow(u, y0), y1), series), None

    return jax.lax.scan(improve, u, None, length=_ITERATIONS)[0]


@cached
def _algebra_scheme(method: Method) -> _Scheme:
    """Return the polynomials of the basis, one flow."""
    degree = len(extension_of(method).basis)
    weights = np.zeros((1, degree, degree))
    for d, p in enumerate(basis_polynomials(degree)):
        weights[0, d, : d + 1] = p.coef[1 : d + 2]
    return _Scheme(weights)


def _by_flows(method: Method, start: Start, y1: JaxArray, last: JaxArray) -> _Interpolant:
    rules, f, h, y0 = start.rules, start.f, start.h, start.y0
    schemes = _flow_schemes(method)

    def close(fields: JaxArray, scheme: _Scheme) -> _Interpolant:
        """Add the last flow, which leads to the end of the step."""
        before = _Interpolant(y0, jnp.pad(fields, ((0, 1), (0, 0))), rules, scheme)
        left = rules.nearby(before(jnp.ones((), h.dtype)), y1)
        return _Interpolant(y0, jnp.concatenate([fields, left[None]]), rules, scheme)

    ends = h * jnp.stack([start.first, last])
    level = close(ends, schemes[0])
    for count, scheme in enumerate(schemes[1:], 3):
        theta = jnp.asarray(nodes_of(count).nodes[1:-1], h.dtype)

        def evaluate(node: JaxArray, level: _Interpolant = level) -> JaxArray:
            return h * f(node, level(node))

        inner = jax.lax.map(evaluate, theta)
        level = close(jnp.concatenate([ends[:1], inner, ends[1:]]), scheme)
    return level


@cached
def _flow_schemes(method: Method) -> list[_Scheme]:
    r"""Return the weights of interpolants with 2, 3, … nodes.

    A flow has weights :math:`\theta \sum_k w_k L_j(c_k \theta)` of the coefficients at nodes,
    with Lagrange's polynomials, and the last one the blend.
    """
    c, flows = flows_within(method)
    schemes = []
    for count in range(2, node_count(method) + 1):
        at = nodes_of(count)
        weights = np.zeros((len(flows) + 1, count + 1, count + 1))
        for j in range(count):
            others = np.delete(at.nodes, j)
            lagrange = Polynomial.fromroots(others) / np.prod(at.nodes[j] - others)
            for m, coefficient in enumerate(lagrange.coef):
                weights[:-1, j, m] = coefficient * (flows @ c**m)
        weights[-1, -1, :] = at.blend.coef[1 : count + 2]
        schemes.append(_Scheme(weights))
    return schemes
