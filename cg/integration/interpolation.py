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

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import fields as dataclass_fields

import numpy as np

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.flows import difference_of
from cg.integration.interpolant import Indices, Interpolant, nodes_of, result_flows
from cg.integration.stepper import Block, Stepper, advances_by_embedded
from cg.method import Method

__all__ = ["Steps", "extra_evaluations", "flows_within", "interpolant_of", "interpolate"]


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


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps with the coefficients at both ends, of one integration or of several.

    Attributes
    ----------
    t0, h
        Where they start, and their signed sizes, shape ``(steps,)``.
    y0, y1
        Points at both ends, shape ``(steps, *batch, *point_shape)``.
    first, last
        Coefficients there, shape ``(steps, *batch, dim)``.
    """

    t0: Array
    h: Array
    y0: Points
    y1: Points
    first: Array
    last: Array

    def __len__(self) -> int:
        return len(self.t0)

    @staticmethod
    def of(block: Block, which: Indices, last_slope: Callable[[], Array]) -> Steps:
        """Return some steps of a block.

        Parameters
        ----------
        block
            It has slopes.
        which
            The steps, shape ``(n,)``, sorted.
        last_slope
            Returns the coefficients at the end of the block, shape ``(*batch, dim)``.
        """
        assert block.slopes is not None
        end = len(block.slopes) - 1
        t0 = block.t[which]
        following = block.slopes[np.minimum(which + 1, end)]
        if which[-1] == end:
            following[-1] = last_slope()
        h = block.t[which + 1] - t0
        return Steps(t0, h, block.y[which], block.y[which + 1], block.slopes[which], following)

    @staticmethod
    def join(parts: list[Steps]) -> Steps:
        """Return the steps of all parts."""
        return Steps(
            *(
                np.concatenate([getattr(part, entry.name) for part in parts])
                for entry in dataclass_fields(Steps)
            )
        )


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
    steps = Steps.of(block, which, stepper.last_slope)
    stepper.counts.nexp += len(steps) * flows_within(stepper.method)
    return interpolant_of(
        stepper.frame, stepper.method, steps, lambda _, t, y: stepper.evaluate(t, y)
    )


def flows_within(method: Method) -> int:
    """Return how many flows the interpolant of a step takes, without those that evaluate it."""
    made = node_count(method) - 1 + extra_evaluations(method)
    return made * (len(result_flows(method)) + 1)


def interpolant_of(
    frame: Frame,
    method: Method,
    steps: Steps,
    evaluate: Callable[[Indices, Array, Points], Array],
) -> Interpolant:
    """Return the solution within steps, after evaluating ``f`` at the nodes.

    Parameters
    ----------
    frame, method
        The frame, and the method that made the steps.
    steps
        The steps.
    evaluate
        Returns coefficients, shape ``(n, *batch, dim)``, within the steps of the given indices at
        times ``(n,)`` and points ``(n, *batch, *point_shape)``.
    """
    flows = result_flows(method)
    fields = np.stack([steps.first, steps.last], axis=1)
    count = node_count(method)
    every = np.arange(len(steps))
    for nodes in range(2, count + 1):
        made = _closed(
            Interpolant(
                frame, flows, nodes_of(nodes), steps.t0, steps.h, steps.y0, steps.y1, fields,
                steps.first,
            )
        )  # fmt: skip
        if nodes == count:
            break
        inner = nodes_of(nodes + 1).nodes[1:-1]
        which, theta = np.repeat(every, len(inner)), np.tile(inner, len(steps))
        values = evaluate(which, steps.t0[which] + theta * steps.h[which], made(which, theta))
        values = values.reshape(len(steps), len(inner), *values.shape[1:])
        fields = np.concatenate([fields[:, :1], values, fields[:, -1:]], axis=1)
    return made


def _closed(open_: Interpolant) -> Interpolant:
    """Return an interpolant with the last flow that leads to the ends of the steps."""
    steps = np.arange(len(open_))
    reached = open_.between(steps, np.ones(len(steps)), None)
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
