"""Frames and methods as the compiled loop over steps takes them, prepared for any run."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np

from cg.frames.arrays import Array, Points
from cg.frames.base import MEMBERSHIP_TOLERANCE, Frame
from cg.integration.blocks import block_constants, describe_blocks, is_compiled
from cg.integration.interpolant import AlgebraFlow, node_count, nodes_of, result_flows
from cg.integration.paths import paths_of
from cg.method import Method, remembered
from cg.munthe_kaas import MuntheKaas
from cg.shared_numbers import BlockKind

__all__ = ["Plan", "error_exponent", "plan_of"]


class Plan:
    """What compiled code knows of a frame and a method.

    Parameters
    ----------
    frame
        Any frame; those that aren't compiled are reached through callbacks.
    method
        Any method; coefficients at implicit stages are found through callbacks.

    Attributes
    ----------
    address
        Where compiled code has it.
    width
        Number of doubles of a point.
    nodes
        Number of nodes of the interpolant within a step.
    exponent
        Power of an error that a step is proportional to.
    """

    def __init__(self, frame: Frame, method: Method) -> None:
        import cg._external as core

        self.frame = frame
        self.method = method
        self.compiled = is_compiled(frame)
        entries = int(np.prod(frame.point_shape, dtype=np.int64))
        self.parts = 2 if frame.dtype == np.complex128 else 1
        self.width = entries * self.parts
        self._in_algebra: bool | None = None
        self.exponent = 0.0 if method.embedded_order is None else error_exponent(method)
        self.nodes = node_count(method)
        if self.compiled:
            blocks = describe_blocks(frame)
        else:
            blocks = np.array([[BlockKind.CALLBACK], [frame.dim], [self.width]], dtype=np.intc)
        paths = paths_of(method)
        flows = result_flows(method)
        algebra = flows if isinstance(flows, AlgebraFlow) else None
        used = len(flows.c)
        self.result_flows = len(flows)
        self.address: int = core.plan_open(
            blocks, block_constants(frame), paths.integers, *paths.doubles, not method.explicit,
            *_node_tables(self.nodes), flows.c, flows.weights.T,
            np.zeros((used, used)) if algebra is None else algebra.a.T,
            0 if algebra is None else algebra.order,
        )  # fmt: skip
        weakref.finalize(self, core.plan_close, self.address)

    def __reduce__(self) -> tuple[Any, ...]:
        return plan_of, (self.frame, self.method)

    def look_at(self, point: Points) -> None:
        """Find out, at any point, in what differences of points are measured."""
        if self._in_algebra is None:
            self._in_algebra = self.frame.exp_coordinates(point, point) is not None

    @property
    def in_algebra(self) -> bool:
        """Whether differences of points are measured in coordinates, not in entries."""
        assert self._in_algebra is not None
        return self._in_algebra

    @property
    def tolerance_shape(self) -> tuple[int, ...]:
        """The shape that absolute tolerances may have."""
        return (self.frame.dim,) if self.in_algebra else self.frame.point_shape

    def certainly_on(self, points: Points) -> bool:
        """Tell whether points are on the manifold; if not, it takes a closer look."""
        import cg._external as core

        return self.compiled and core.plan_distance_bound(self.address, self.doubles(points).T) <= (
            0.1 * MEMBERSHIP_TOLERANCE
        )

    def distance_off(self, points: Points) -> float | None:
        """Return how far off the manifold the worst of finite points is, None if it isn't far.

        Infinite distances don't count: they are those of regular matrices without digits of that.
        """
        if len(points) == 0 or self.certainly_on(points):
            return None
        distances = self.frame.relative_error(points)
        distance = float(distances[np.isfinite(distances)].max(initial=0.0))
        return distance if distance > MEMBERSHIP_TOLERANCE else None

    def doubles(self, points: Points) -> Array:
        """Return points as rows of doubles, shape ``(n, width)``."""
        rows = np.ascontiguousarray(points, dtype=self.frame.dtype)
        return rows.reshape(-1).view(np.float64).reshape(-1, self.width)

    def points(self, rows: Array, lead: tuple[int, ...]) -> Points:
        """Return points of shape ``(*lead, *point_shape)`` that share memory with doubles."""
        return rows.reshape(-1).view(self.frame.dtype).reshape(*lead, *self.frame.point_shape)


def plan_of(frame: Frame, method: Method) -> Plan:
    """Return the plan of a frame and a method, which is made once."""
    plans = _plans(method)
    try:
        return plans[frame]
    except KeyError:
        plans[frame] = plan = Plan(frame, method)
        return plan
    except TypeError:  # a frame of the user that can't be hashed
        return Plan(frame, method)


@remembered
def _plans(method: Method) -> dict[Frame, Plan]:
    return {}


def _node_tables(nodes: int) -> tuple[Array, Array]:
    """Return the nodes and the last flows' polynomials of interpolants with 2, ..., n nodes."""
    node, blend = np.zeros((nodes, nodes - 1)), np.zeros((nodes + 2, nodes - 1))
    for count in range(2, nodes + 1):
        nodes_here = nodes_of(count)
        node[:count, count - 2] = nodes_here.nodes
        blend[: count + 2, count - 2] = nodes_here.blend.coef
    return np.asfortranarray(node), np.asfortranarray(blend)


def error_exponent(method: Method) -> float:
    """Return the power of an error that a step is proportional to, by the orders of a pair."""
    if method.third_order is not None:
        advancing = method.advancing if isinstance(method, MuntheKaas) else method
        second, third = advancing.embedded_order or 0, method.third_order
        return 1.0 / max(2 * (second + 1) - (third + 1), 1)
    orders = method.order, method.embedded_order
    return 1.0 / (min(order for order in orders if order is not None) + 1)
