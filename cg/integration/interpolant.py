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

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from cg.frames.arrays import Array
from cg.integration.paths import paths_of
from cg.method import Method, remembered
from cg.munthe_kaas import MuntheKaas

__all__ = [
    "AlgebraFlow",
    "NodeSet",
    "ResultFlows",
    "extra_evaluations",
    "node_count",
    "nodes_of",
    "result_flows",
]


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


@cache
def nodes_of(count: int) -> NodeSet:
    """Return the nodes for interpolants with so many of them, at least 2."""
    inner = np.sort(np.real(Legendre.basis(count).deriv().roots()))
    lobatto = np.concatenate([[0.0], 0.5 * (inner + 1.0), [1.0]])
    nodes = np.delete(lobatto, (count + 1) // 2)
    integral = Polynomial.fromroots(nodes).integ()
    return NodeSet(nodes, integral / integral(1.0))


def advances_by_embedded(method: Method) -> bool:
    """Tell whether the second result of a pair is of higher order, and makes the steps."""
    embedded = method.embedded_order
    return embedded is not None and embedded > method.order


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


@remembered
def result_flows(method: Method) -> ResultFlows:
    """Return the flows that lead to the result of a method."""
    return AlgebraFlow(method) if isinstance(method, MuntheKaas) else ResultFlows(method)
