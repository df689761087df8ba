"""Plans: descriptions of a frame and a method in compiled code, for any number of runs."""

from __future__ import annotations

import ctypes
import weakref
from typing import Any

import numpy as np

from cg import _core_r64 as core
from cg.frames.base import Frame
from cg.frames.blocks import constants_of, describe_blocks
from cg.frames.facts import facts_of
from cg.frames.linear_action import LinearAction
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.phase_space import PhaseSpace, linkage_of
from cg.frames.product import Product
from cg.integration.rhs.form import RhsForm
from cg.support.arrays import Array, Points
from cg.support.capsules import provide_lapack
from cg.support.shared_numbers import BlockKind, BlockOption
from cg.tables import Kind, MethodTable

_MAX_PLANS = 64  # number of plans that are kept for a frame
_MAX_FIELDS = 64  # largest dimension of a frame in Python whose rank is computed


class Plan:
    """A frame and a method in compiled code.

    A frame in Python is called through callbacks. Where ``user_frame`` is given, right-hand sides
    return derivatives of its points, along which ``frame`` moves them. ``core`` is the compiled
    module, and ``address`` that of the plan; ``width`` is the number of doubles of a point,
    ``interpolant_vectors`` the number of vectors of an interpolant. ``step_table`` is the table
    whose steps compiled code takes: the same, or on a `LinearAction` one flow along a polynomial.
    """

    def __init__(self, frame: Frame, table: MethodTable, user_frame: Frame | None = None) -> None:
        self.core, self.frame, self.table = core, frame, table
        self.user_frame = frame if user_frame is None else user_frame
        self.form = RhsForm(frame, user_frame is not None)
        along = table.polynomial if isinstance(frame, LinearAction) else None
        self.step_table = table if along is None else along
        facts = facts_of(frame)
        self._blocks, self.compiled = facts.blocks, facts.compiled
        self._has_difference = facts.has_difference
        conditions = isinstance(frame, PhaseSpace) and frame.has_conditions
        self._has_distance_bound = self.compiled and not conditions
        self.dtype, self.dim, self.point_shape = frame.dtype, frame.dim, frame.point_shape
        self.reals_per_entry = 2 if self.dtype == np.complex128 else 1
        self.width = int(np.prod(frame.point_shape, dtype=np.int64)) * self.reals_per_entry
        self.interpolant_vectors = self.step_table.output.interpolant_vectors
        self.address = self._open()
        weakref.finalize(self, core.plan_close, self.address)
        self._linkage = self._share_mechanics()  # kept alive, since compiled code calls it

    def _open(self) -> int:
        """Open the plan in compiled code and return its address."""
        frame, table, described = self.frame, self.step_table, self._blocks
        if described is None:
            blocks = np.array([[BlockKind.CALLBACK], [frame.dim], [self.width]], dtype=np.intc)
            constants = frame.turning_coefficients()
        else:
            blocks, constants = describe_blocks(described).copy(), constants_of(described)
        if table.is_polynomial or not table.explicit:
            provide_lapack()
        if table.is_polynomial:
            blocks[2] |= BlockOption.POLYNOMIAL
        address: int = self.core.plan_open(
            blocks, constants, self.form.derivatives, ctypes.addressof(table.record)
        )
        return address

    def _share_mechanics(self) -> Any:
        """Share bodies and joints of a phase space; return its linkage, None without joints."""
        space: Any = self.frame
        if isinstance(space, Product) and not isinstance(space, PhaseSpace):
            space = space.factors[0]  # the phase space where points hold derivatives
        if not isinstance(space, PhaseSpace):
            return None
        if self.step_table.kind is Kind.SPLITTING or space is self.frame:
            tangents = self.dim // space.dim - 1
            if self.core.plan_set_bodies(self.address, *space.compiled_bodies(), tangents):
                raise MemoryError("there is not enough memory for the inertia of bodies")
        if not space.jointed:
            return None
        linkage = linkage_of(space)  # whose functions compiled code calls
        self.core.plan_share_joints(self.address, linkage.address)
        return linkage

    def __reduce__(self) -> tuple[Any, ...]:
        # a table is sent by its name, so that each process has one instance with its cached data
        return plan_of, (self.frame, self.table, self.user_frame if self.form.derivatives else None)

    def in_coordinates(self, point: Points) -> bool:
        """Return whether differences of points are measured in coordinates, not in entries.

        The answer is the same at all points.
        """
        if self.compiled:
            return self._has_difference
        return self.frame.exp_coordinates(point, point) is not None

    def unique_flows(self, point: Points) -> bool:
        """Return whether the fields act freely: small coefficients that differ move points apart.

        Then the ends of a step determine its coordinates. Any point of a frame whose differences
        are measured in coordinates serves as ``point``.
        """
        frame = self.frame
        if self._blocks is not None:
            return all(block[0] != BlockKind.SPHERE for block in self._blocks)
        if frame.dim > _MAX_FIELDS or not facts_of(frame).has_brackets:
            return False
        fields = np.asarray(frame.field(np.eye(frame.dim), point), dtype=frame.dtype)
        rank = np.linalg.matrix_rank(fields.reshape(frame.dim, -1).view(np.float64))
        return bool(rank == frame.dim)

    def surely_on_manifold(self, points: Points) -> bool:
        """Return whether a cheap bound shows that points, or their doubles, are on the manifold."""
        bound: float = self.core.plan_distance_bound(self.address, self.doubles(points).T)
        return self.is_small(bound)

    def is_small(self, bound: float) -> bool:
        """Return whether points of which compiled code bounds the distance are on the manifold."""
        return self._has_distance_bound and bound <= 0.1 * MEMBERSHIP_TOLERANCE

    def doubles(self, points: Points) -> Array:
        """Return points as rows of doubles, shape ``(n, width)``."""
        if self.reals_per_entry == 2:
            points = np.ascontiguousarray(points).reshape(-1).view(np.float64)
        return points.reshape(-1, self.width)

    def points(self, rows: Array, lead: tuple[int, ...]) -> Points:
        """Return points of shape ``(*lead, *point_shape)`` that share memory with doubles."""
        if self.reals_per_entry == 2:
            rows = rows.reshape(-1).view(self.dtype)
        return rows.reshape(*lead, *self.point_shape)


def plan_of(frame: Frame, table: MethodTable, user_frame: Frame | None = None) -> Plan:
    """Return the plan of a frame and a method, which is cached."""
    # facts stand for all equal frames
    key = id(table), None if user_frame is None else facts_of(user_frame)
    plans = facts_of(frame).plans
    plan = plans.get(key)
    if plan is None:
        if len(plans) >= _MAX_PLANS:  # threads may add a few more
            plans.pop(next(iter(plans)), None)
        plan = plans[key] = Plan(frame, table, user_frame)  # a plan keeps its table alive
    return plan
