r"""The solution between steps, on the manifold and as accurate as the steps.

Within a step from :math:`y_0` to :math:`y_1` the coefficients :math:`F(\theta) = f(t_0 + \theta h,
y(\theta))` are interpolated at nodes :math:`0 = \theta_1 < \dots < \theta_n = 1` by a polynomial
:math:`P`.  The solution of :math:`y' = h \sum_i P_i(\theta) E_i(y)` is then a problem whose right
side depends on time alone: the method itself solves it, to its own order, by the few flows that
lead to its result, without any evaluation of ``f``,

.. math::

    z(\theta) = \prod_m \exp\Bigl(\theta h \sum_k \alpha_{m,k} P(c_k \theta)\Bigr) y_0 ,

and what is left to :math:`y_1` at the end is made up by one flow more,

.. math::

    y(\theta) = e^{w(\theta) v} z(\theta), \qquad e^v z(1) = y_1, \qquad
    w(\theta) = \int_0^\theta \omega \Big/ \int_0^1 \omega, \qquad
    \omega(\theta) = \prod_j (\theta - \theta_j) .

This is Hermite-Birkhoff interpolation without coordinates.  The polynomial is off by
:math:`\omega` times a constant up to higher order, and so is its integral by that of
:math:`\omega`; the last flow takes this away and leaves derivatives at nodes as they are.  The
error is :math:`O(h^{n+2})`.  Only flows are needed, and the coefficients between two points that
are close to each other, so that it works on every frame.

The coefficients at interior nodes are evaluated where the interpolant with one node less leads
(W. H. Enright, K. R. Jackson, S. P. Nørsett, P. G. Thomsen, "Interpolants for Runge–Kutta
formulas", ACM TOMS 12 (1986), call it bootstrapping), which takes :math:`n - 2` evaluations for n
nodes.  With :math:`p - 1` nodes the error is :math:`O(h^{p+1})`, that of a step of order p.  From
order four on there is one node more where a method has as many stages as this takes evaluations:
measured on the pairs of the catalogue, the largest error within a step was then at most 1.5 times
that at its ends; with :math:`p - 1` nodes it was at most 2.6 times for Crouch-Grossman pairs, but 4
to 12 times for commutator-free ones, whose own errors are smaller.  All in all 0, 3, 6, 10, 15
evaluations go into a step of order p = 3, 4, 5, 6, 7 that has output in it, or else 6 for p = 6 and
10 for p = 7; and 15 for p = 8, with p - 1 nodes.

A method on a Lie algebra solves that problem in coordinates: its stages are derivatives of them,
and one flow leads to :math:`z`.  For pairs of this kind the largest error within a step was at most
2.3 times that at its ends.

The nodes are those of Lobatto's formula with one node more, without the one in the middle: that is
the node at which the integral condition interpolates the derivative implicitly, so that the error
between the nodes is that of Lobatto's points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from numpy.typing import NDArray

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.flows import dexpinv_of, difference_of, flows_of
from cg.integration.paths import paths_of
from cg.integration.python_rhs import StepTooLongError
from cg.integration.stepper import Block, Stepper, advances_by_embedded
from cg.method import Method, remembered
from cg.munthe_kaas import MuntheKaas

__all__ = ["Interpolant", "extra_evaluations", "interpolate", "nodes_of"]

Indices = NDArray[np.intp]


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


def node_count(method: Method) -> int:
    """Return how many nodes make the interpolant as accurate as the steps of a method."""
    order = method.embedded_order if advances_by_embedded(method) else method.order
    enough = max(2, (order or 0) - 1)
    return enough + (enough > 2 and _evaluations(enough + 1) <= method.stages)


def extra_evaluations(method: Method) -> int:
    """Return how many evaluations of ``f`` an interpolant takes, besides those at both ends."""
    return _evaluations(node_count(method))


def _evaluations(nodes: int) -> int:
    return sum(range(1, nodes - 1))


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
                coordinates = np.tensordot(row[:stage], k[:stage], axes=1)
                k[stage] = dexpinv(coordinates, k[stage])
        return np.tensordot(self.weights[0], k, axes=1)[..., None, :]


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
        points = self._between(which, theta, self.rest[which])
        for value, ends in ((0.0, self.y0), (1.0, self.y1)):
            there = theta == value
            points[there] = ends[which[there]]
        return points

    def at(self, which: Indices, t: Array) -> Points:
        """Return points at times within steps; see `__call__`."""
        theta = np.clip((t - self.t0[which]) / self.h[which], 0.0, 1.0)
        return self(which, theta)

    def _between(self, which: Indices, theta: Array, rest: Array | None) -> Points:
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


def interpolate(stepper: Stepper, block: Block, which: Indices) -> Interpolant:
    """Return the solution within some steps of a block, after evaluating ``f`` at the nodes.

    Parameters
    ----------
    stepper
        Has just given the block.
    block
        It has slopes.
    which
        The steps, shape ``(n,)``, sorted.
    """
    assert block.slopes is not None
    last = len(block.slopes) - 1
    t0, y0, first = block.t[which], block.y[which], block.slopes[which]
    y1 = block.y[which + 1]
    following = block.slopes[np.minimum(which + 1, last)]
    if which[-1] == last:
        following[-1] = stepper.last_slope()
    h = block.t[which + 1] - t0
    flows = result_flows(stepper.method)
    fields = np.stack([first, following], axis=1)
    count = node_count(stepper.method)
    steps = np.arange(len(which))
    for nodes in range(2, count + 1):
        made = _closed(
            Interpolant(stepper.frame, flows, nodes_of(nodes), t0, h, y0, y1, fields, first)
        )
        stepper.counts.nexp += len(which) * (len(flows) + 1)
        if nodes == count:
            break
        inner = nodes_of(nodes + 1).nodes[1:-1]
        at = np.repeat(steps, len(inner)), np.tile(inner, len(steps))
        points = made(*at)
        stepper.counts.nexp += len(points) * (len(flows) + 1)
        values = stepper.evaluate(t0[at[0]] + at[1] * h[at[0]], points)
        values = values.reshape(len(steps), len(inner), *values.shape[1:])
        fields = np.concatenate([fields[:, :1], values, fields[:, -1:]], axis=1)
    return made


def _closed(open_: Interpolant) -> Interpolant:
    """Return an interpolant with the last flow that leads to the ends of the steps."""
    steps = np.arange(len(open_))
    reached = open_._between(steps, np.ones(len(steps)), None)
    rest = _difference(open_.frame, reached, open_.y1)
    return Interpolant(
        open_.frame, open_.flows, open_.nodes, open_.t0, open_.h, open_.y0, open_.y1, open_.fields,
        rest,
    )  # fmt: skip


def _difference(frame: Frame, y0: Points, y1: Points) -> Array:
    """Return the coefficients between points that are close to each other, NaN where one is NaN."""
    axes = tuple(range(-len(frame.point_shape), 0))
    there = (np.isfinite(y0) & np.isfinite(y1)).all(axis=axes)
    rest = difference_of(frame)(y0, y1)
    if rest is None:
        rest = np.full((*there.shape, frame.dim), np.nan)
    missing = there & ~np.isfinite(rest).all(axis=-1)
    if missing.any():
        rest[missing] = frame.nearby_coordinates(y0[missing], y1[missing])
    return rest
