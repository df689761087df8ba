"""Plans: descriptions of a frame and a method in compiled code, for any number of runs."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, TypeVar

import numpy as np

from cg.catalogue import find_method, resolve_method
from cg.frames.base import Frame
from cg.frames.linear_action import LinearAction
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.phase_space import PhaseSpace
from cg.integration.step.compiled_frames import (
    block_constants,
    describe_blocks,
    has_compiled_difference,
    is_compiled,
)
from cg.integration.step.implicit import is_collocation
from cg.integration.step.interpolant import (
    extension_of,
    flows_within,
    node_count,
    nodes_of,
    result_flows,
    series_order,
)
from cg.integration.step.paths import MethodPaths, paths_of, polynomial_paths
from cg.method.estimate import error_power
from cg.method.magnus import MagnusMethod
from cg.method.method import Method
from cg.method.munthe_kaas import MuntheKaas
from cg.support.arrays import Array, Points
from cg.support.capsules import provide_lapack
from cg.support.shared_numbers import BlockKind, BlockOption


class Plan:
    """A frame and a method in compiled code.

    A frame in Python is called through callbacks. ``core`` is the compiled module, and ``address``
    that of the plan; ``width`` the number of doubles of a point, ``columns`` that of vectors of an
    interpolant; ``exponent`` the power of an error that a step is proportional to, 0 without an
    estimate of the error. ``kept`` vectors of coefficients are stored for a step: its stages, with
    the end where the error estimate needs it, or one register; ``kept_nodes`` are those of the step
    before, of a Magnus method.
    """

    def __init__(self, frame: Frame, method: Method) -> None:
        import cg._core_r64 as core

        self.core, self.frame, self.method = core, frame, method
        self.compiled = is_compiled(frame)
        self._measures = has_compiled_difference(frame) if self.compiled else None
        self.dtype, self.dim, self.point_shape = frame.dtype, frame.dim, frame.point_shape
        self.parts = 2 if self.dtype == np.complex128 else 1
        self.width = int(np.prod(frame.point_shape, dtype=np.int64)) * self.parts
        self.series = series_order(method)  # order up to which that of dexp⁻¹ is needed
        self.collocation = is_collocation(method)
        if self.compiled:
            blocks = describe_blocks(frame)
        else:
            blocks = np.array([[BlockKind.CALLBACK], [frame.dim], [self.width]], dtype=np.intc)
        self.paths = paths = paths_on(frame, method)
        self.exponent = 0.0 if method.embedded_order is None else error_exponent(method)
        if paths.polynomial or not method.explicit:
            provide_lapack()
        if paths.polynomial:
            blocks[2] |= BlockOption.POLYNOMIAL
            self.exponent = 1.0 / (method.stages + paths.power)
        self.implicit = self.collocation or paths.blocks > 0
        columns = len(paths.stages) + len(paths.brackets)
        self.kept = columns if paths.registers is None else 1
        of_nodes = isinstance(method, MagnusMethod) and method.stages > 2
        self.kept_nodes = columns if of_nodes else 0
        self.address: int = core.plan_open(
            blocks, block_constants(frame), ctypes.addressof(paths.record)
        )
        if isinstance(frame, PhaseSpace):
            core.plan_set_bodies(self.address, *frame.compiled_bodies())
        weakref.finalize(self, core.plan_close, self.address)
        self.columns = self._make_interpolants()

    def __reduce__(self) -> tuple[Any, ...]:
        # a method is sent by its name, so that each process has one instance with its cached data
        known = find_method(self.method.name) is self.method
        return _restored, (self.frame, self.method.name if known else self.method)

    def _make_interpolants(self) -> int:
        method, polynomial = self.method, self.paths.polynomial
        nodes = method.stages if polynomial else node_count(method)
        extension = extension_of(method)
        flow_c, weights = result_flows(self.paths) if polynomial else flows_within(method)
        flat = isinstance(method, MuntheKaas)
        columns = max(len(extension.basis), nodes + 1)
        padded = np.pad(extension.rows, ((0, 1), (0, 0)))  # arrays can't be empty
        self.core.plan_set_scheme(
            self.address, columns, flat, extension.final + 1, self.series,
            np.append(extension.theta, 0.0), padded.T, extension.basis.T, polynomial,
            *_node_tables(nodes, self.paths.abscissae if polynomial else None),
            flow_c, weights.T,
        )  # fmt: skip
        return columns

    def in_coordinates(self, point: Points) -> bool:
        """Return whether differences of points are measured in coordinates, not in entries.

        The answer is the same at all points.
        """
        if self._measures is not None:
            return self._measures
        return self.frame.exp_coordinates(point, point) is not None

    def unique_flows(self, point: Points) -> bool:
        """Return whether the fields act freely: small coefficients that differ move points apart.

        Then the ends of a step determine its coordinates. Any point of a frame whose differences
        are measured in coordinates serves as ``point``.
        """
        frame = self.frame
        if self.compiled:
            blocks = frame.compiled_blocks() or ()
            return all(block[0] != BlockKind.SPHERE for block in blocks)
        if frame.dim > _MAX_FIELDS or not has_brackets(frame):
            return False
        fields = np.asarray(frame.field(np.eye(frame.dim), point), dtype=frame.dtype)
        rank = np.linalg.matrix_rank(fields.reshape(frame.dim, -1).view(np.float64))
        return bool(rank == frame.dim)

    def surely_on_manifold(self, points: Points) -> bool:
        """Return whether a cheap bound shows that points, or their doubles, are on the manifold."""
        if not self.compiled:
            return False
        bound = self.core.plan_distance_bound(self.address, self.doubles(points).T)
        return bool(bound <= 0.1 * MEMBERSHIP_TOLERANCE)

    def doubles(self, points: Points) -> Array:
        """Return points as rows of doubles, shape ``(n, width)``."""
        rows = np.ascontiguousarray(points)
        if self.parts == 2:
            rows = rows.reshape(-1).view(np.float64)
        return rows.reshape(-1, self.width)

    def points(self, rows: Array, lead: tuple[int, ...]) -> Points:
        """Return points of shape ``(*lead, *point_shape)`` that share memory with doubles."""
        if self.parts == 2:
            rows = rows.reshape(-1).view(self.dtype)
        return rows.reshape(*lead, *self.point_shape)


_MAX_FRAMES = 64  # whose results are kept
_MAX_PLANS = 64  # of a frame that are kept
_MAX_FIELDS = 64  # largest dimension of a frame in Python whose rank is computed


_Result = TypeVar("_Result")


def cached_by_frame(function: Callable[[Frame], _Result]) -> Callable[[Frame], _Result]:
    """Keep the last results of a function, unless a frame of the user can't be hashed."""
    results = lru_cache(maxsize=_MAX_FRAMES)(function)
    last: Any = None, None

    @wraps(function)
    def call(frame: Frame) -> _Result:
        nonlocal last
        known, result = last
        if known is not frame:
            try:
                result = results(frame)
            except TypeError:
                return function(frame)
            last = frame, result
        return result  # type: ignore[no-any-return]

    return call


def plan_of(frame: Frame, method: Method) -> Plan:
    """Return the plan of a frame and a method, which is cached."""
    plans = _plans_on(frame)
    plan = plans.get(id(method))  # hashing coefficients takes long
    if plan is None:
        if len(plans) == _MAX_PLANS:
            plans.pop(next(iter(plans)), None)
        plan = plans[id(method)] = Plan(frame, method)  # which keeps the method alive
    return plan


@cached_by_frame
def _plans_on(frame: Frame) -> dict[int, Plan]:
    return {}


def _restored(frame: Frame, method: str | Method) -> Plan:
    return plan_of(frame, resolve_method(method))


def paths_on(frame: Frame, method: Method) -> MethodPaths:
    """Return the paths of a method on a frame."""
    if isinstance(frame, LinearAction) and isinstance(method, MagnusMethod):
        return polynomial_paths(method) or paths_of(method)
    return paths_of(method)


def _node_tables(nodes: int, stages: Array | None) -> tuple[Array, Array]:
    """Return the nodes and the last flows' polynomials of interpolants with 2, ..., n nodes.

    With nodes at given stages there is one interpolant.
    """
    node, blend = np.zeros((nodes, nodes - 1)), np.zeros((nodes + 2, nodes - 1))
    if stages is not None:
        node[:, -1] = stages
        return np.asfortranarray(node), np.asfortranarray(blend)
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
        return 1.0 / max(second + 1 + error_power(advancing) * (second - third), 1)
    orders = method.order, method.embedded_order
    return 1.0 / (min(order for order in orders if order is not None) + 1)


@cached_by_frame
def has_brackets(frame: Frame) -> bool:
    """Return whether a frame has brackets of its fields."""
    try:
        frame.bracket(np.zeros(frame.dim), np.zeros(frame.dim))
    except NotImplementedError:
        return False
    return True
