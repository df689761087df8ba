"""The solution within steps, as flows of a polynomial; `cg.integration.interpolation` makes it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from numpy.typing import NDArray

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.flows import dexpinv_of, flows_of
from cg.integration.paths import paths_of
from cg.integration.python_rhs import StepTooLongError
from cg.integration.stepper import advances_by_embedded
from cg.method import Method, remembered
from cg.munthe_kaas import MuntheKaas

__all__ = ["Indices", "Interpolant", "NodeSet", "ResultFlows", "nodes_of", "result_flows"]

Indices = NDArray[np.intp]

_AT_A_TIME = 4096  # times of all members, each of which takes a few kilobytes on the way


@dataclass(frozen=True, eq=False)
class NodeSet:
    """Nodes within a step.

    Attributes
    ----------
    nodes
        From 0 to 1, shape ``(n,)``.
    blend
        The polynomial w.
    """

    nodes: Array
    blend: Polynomial

    def basis(self, s: Array) -> Array:
        """Return Lagrange's polynomials at ``s``, shape ``(*s.shape, n)``."""
        differences = s[..., None] - self.nodes
        values = np.empty((*s.shape, len(self.nodes)))
        for j, node in enumerate(self.nodes.tolist()):
            others = np.delete(np.arange(len(self.nodes)), j)
            values[..., j] = np.prod(
                differences[..., others] / (node - self.nodes[others]), axis=-1
            )
        return values


@cache
def nodes_of(count: int) -> NodeSet:
    """Return the nodes for interpolants with so many of them, at least 2."""
    inner = np.sort(np.real(Legendre.basis(count).deriv().roots()))
    lobatto = np.concatenate([[0.0], 0.5 * (inner + 1.0), [1.0]])
    nodes = np.delete(lobatto, (count + 1) // 2)
    integral = Polynomial.fromroots(nodes).integ()
    return NodeSet(nodes, integral / integral(1.0))


class ResultFlows:
    """The flows that lead to the result of a method, for fields that depend on time alone.

    Parameters
    ----------
    method
        Explicit or implicit.
    """

    def __init__(self, method: Method) -> None:
        if method.explicit:
            paths = paths_of(method)
            flows = [dict(flow) for flow in paths.result_flows]
            c = np.array(paths.c, dtype=np.float64)
        else:
            row = method.b_embedded if advances_by_embedded(method) else method.b
            assert row is not None
            flows = [{k: weight} for k, weight in enumerate(row.tolist()) if weight != 0.0]
            c = method.c
        used = sorted({stage for flow in flows for stage in flow})
        self.c: Array = c[used]
        self.weights = np.array([[float(flow.get(k, 0)) for k in used] for flow in flows])

    def __len__(self) -> int:
        return len(self.weights)

    def coefficients(self, frame: Frame, basis: Array, fields: Array) -> Array:
        """Return the coefficients of the flows.

        Parameters
        ----------
        frame
            The frame.
        basis
            Weights of nodes for each used stage, times the step: shape ``(q, stages, nodes)``.
        fields
            Coefficients at the nodes, shape ``(q, nodes, *batch, dim)``.

        Returns
        -------
        ndarray
            Shape ``(q, *batch, flows, dim)``.
        """
        weights = np.einsum("ms,qsj->qmj", self.weights, basis)
        return np.asarray(np.einsum("qmj,qj...d->q...md", weights, fields))


class AlgebraFlow(ResultFlows):
    """The flow that leads to the result of a method on a Lie algebra, likewise.

    Parameters
    ----------
    method
        Its stages are solved in coordinates, without a flow.
    """

    def __init__(self, method: MuntheKaas) -> None:
        method = method.advancing
        self.order = max(method.order, 1)
        used = np.flatnonzero(method.b).tolist()
        for stage in range(method.stages - 1, -1, -1):
            if stage in used:
                used = sorted({*used, *np.flatnonzero(method.a[stage]).tolist()})
        self.c = method.c[used]
        self.weights = method.b[None, used]
        self.a = method.a[np.ix_(used, used)]

    def coefficients(self, frame: Frame, basis: Array, fields: Array) -> Array:
        """Return the coefficients of the flow; see `ResultFlows.coefficients`."""
        k = np.ascontiguousarray(np.einsum("qsj,qj...d->sq...d", basis, fields))
        dexpinv = dexpinv_of(frame, self.order)
        for stage, row in enumerate(self.a):
            if row.any():
                k[stage] = dexpinv(_combined(row[:stage], k), k[stage])
        return _combined(self.weights[0], k)[..., None, :]


def _combined(weights: Array, k: Array) -> Array:
    """Return a sum of stages, to the bit the same for each step however many there are."""
    total: Array = np.zeros_like(k[0])
    for weight, stage in zip(weights.tolist(), k, strict=False):
        if weight:
            total += weight * stage
    return total


@remembered
def result_flows(method: Method) -> ResultFlows:
    """Return the flows that lead to the result of a method."""
    return AlgebraFlow(method) if isinstance(method, MuntheKaas) else ResultFlows(method)


@dataclass(frozen=True, eq=False)
class Interpolant:
    """The solution within some steps of one integration.

    Attributes
    ----------
    frame
        The frame.
    flows
        The flows of the method.
    nodes
        Where the coefficients are interpolated.
    t0, h
        Where the steps start, and their signed sizes, shape ``(steps,)``.
    y0, y1
        Points at both ends, shape ``(steps, *batch, *point_shape)``.
    fields
        Coefficients at the nodes, shape ``(steps, n, *batch, dim)``.
    rest
        Coefficients of the last flow, shape ``(steps, *batch, dim)``.
    """

    frame: Frame
    flows: ResultFlows
    nodes: NodeSet
    t0: Array
    h: Array
    y0: Points
    y1: Points
    fields: Array
    rest: Array

    def __len__(self) -> int:
        return len(self.t0)

    def __call__(self, which: Indices, theta: Array) -> Points:
        """Return points at fractions of steps.

        Parameters
        ----------
        which
            The steps, shape ``(n,)``.
        theta
            The fractions, 0 to 1, shape ``(n,)``.

        Returns
        -------
        ndarray
            Shape ``(n, *batch, *point_shape)``.
        """
        points = np.empty((len(which), *self.y0.shape[1:]), dtype=self.y0.dtype)
        size = max(1, _AT_A_TIME * self.frame.dim // max(1, self.rest[0].size))
        for begin in range(0, len(which), size):
            part = slice(begin, begin + size)
            points[part] = self.between(which[part], theta[part], self.rest[which[part]])
        for value, ends in ((0.0, self.y0), (1.0, self.y1)):
            there = theta == value
            points[there] = ends[which[there]]
        return points

    def at(self, which: Indices, t: Array) -> Points:
        """Return points at times within steps; see `__call__`."""
        theta = np.clip((t - self.t0[which]) / self.h[which], 0.0, 1.0)
        return self(which, theta)

    def between(self, which: Indices, theta: Array, rest: Array | None) -> Points:
        """Return points at fractions of steps, where the last flow is ``rest`` or left out."""
        basis = self.nodes.basis(theta[:, None] * self.flows.c)  # (n, stages, nodes)
        basis *= (theta * self.h[which])[:, None, None]
        v = self.flows.coefficients(self.frame, basis, self.fields[which])
        if not np.isfinite(v).all():
            self._check(v, which)
        if rest is not None:
            blend = self.nodes.blend(theta).reshape(-1, *[1] * (rest.ndim - 1))
            v = np.concatenate([v, (blend * rest)[..., None, :]], axis=-2)
        return flows_of(self.frame)(v, self.y0[which])

    def _check(self, v: Array, which: Indices) -> None:
        """Raise StepTooLongError if flows have no coefficients, though nodes have finite ones."""
        missing = ~np.isfinite(v).all(axis=(-2, -1))
        missing &= np.isfinite(self.fields[which]).all(axis=(1, -1))
        if missing.any():
            raise StepTooLongError(float(self.t0[which[np.argwhere(missing)[0, 0]]]))

    def part(self, which: Indices) -> Interpolant:
        """Return the solution within some of the steps."""
        arrays = (self.t0, self.h, self.y0, self.y1, self.fields, self.rest)
        return Interpolant(self.frame, self.flows, self.nodes, *(array[which] for array in arrays))

    def member(self, index: tuple[int, ...]) -> Interpolant:
        """Return the solution of one member of an ensemble."""
        lead: Any = (slice(None), *index)
        fields = self.fields[(slice(None), *lead)]
        arrays = (self.y0[lead], self.y1[lead], fields, self.rest[lead])
        return Interpolant(self.frame, self.flows, self.nodes, self.t0, self.h, *arrays)

    @staticmethod
    def join(parts: list[Interpolant]) -> Interpolant:
        """Return the solution within the steps of all parts."""
        if len(parts) == 1:
            return parts[0]
        names = ("t0", "h", "y0", "y1", "fields", "rest")
        arrays = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return Interpolant(parts[0].frame, parts[0].flows, parts[0].nodes, *arrays)
