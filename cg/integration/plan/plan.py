"""Plans: descriptions of a frame and a method in compiled code, for any number of runs.

A frame is its blocks; of implicit methods the iteration belongs to it that solves stage equations.
"""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.coadjoint import CoadjointOrbit
from cg.frames.compiled import compared_by_entries, needs_lapack
from cg.frames.euclidean import Euclidean
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.linear_action import LinearAction
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.phase_space import PhaseSpace, linkage_of
from cg.frames.product import Power, Product
from cg.frames.semidirect import Semidirect
from cg.support.arrays import Array, Points
from cg.support.caches import cached_by_value
from cg.support.capsules import provide_lapack
from cg.support.shared_numbers import BlockKind, BlockOption, StageLimit
from cg.tables import Kind, MethodTable

Dexpinv = Callable[[Array, Array], Array]
"""``dexpinv(u, v)`` is `Frame.dexpinv`."""


def describe_blocks(frame: Frame) -> NDArray[np.int32]:
    """Return the blocks of a compiled frame, shape ``(3, blocks)``."""
    blocks = frame.compiled_blocks() or ()
    if any(map(needs_lapack, blocks)):
        provide_lapack()
    return np.array([block[:3] for block in blocks], dtype=np.int32, order="C").T


def block_constants(frame: Frame) -> NDArray[np.float64]:
    """Return the constants of all blocks of a frame, and a zero, since no array may be empty.

    A frame in Python has one block, whose constants are its `turning_coefficients`.
    """
    if not is_compiled(frame):
        return turning_coefficients(frame)
    constants = [np.ravel(x) for block in frame.compiled_blocks() or () for x in block[3:]]
    return np.concatenate([*constants, [0.0]])


def turning_coefficients(frame: Frame) -> Array:
    """Return 1 for each coefficient that may turn points, 0 for those of translations."""
    if isinstance(frame, Product):
        return np.concatenate([turning_coefficients(factor) for factor in frame.factors])
    if isinstance(frame, Power):
        return np.tile(turning_coefficients(frame.factor), frame.n)
    inner: Any = frame.group if isinstance(frame, Semidirect) else None
    if isinstance(frame, CoadjointOrbit):
        inner = frame.algebra
    if isinstance(inner, Frame):
        return np.pad(turning_coefficients(inner), (0, frame.dim - inner.dim))
    return np.full(frame.dim, float(not isinstance(frame, Euclidean)))


def is_compiled(frame: Frame) -> bool:
    """Return whether compiled code has the flows of a frame."""
    return frame.compiled_blocks() is not None


def has_compiled_difference(frame: Frame) -> bool:
    """Return whether compiled code computes the flow from one point to another."""
    blocks = frame.compiled_blocks()
    return blocks is not None and not compared_by_entries(blocks)


def dexpinv_of(frame: Frame, order: int) -> Dexpinv:
    """Return `Frame.dexpinv` for a method of some order."""
    import cg._core_r64 as core

    if isinstance(frame, HomogeneousSpace) and is_compiled(frame.group):
        frame = frame.group
    if not is_compiled(frame):
        return partial(frame.dexpinv, order=order)
    description = describe_blocks(frame)

    def dexpinv(u: Array, v: Array) -> Array:
        result = np.array(v, order="C")
        if result.size:
            coordinates = np.ascontiguousarray(u).reshape(-1)
            core.frame_dexpinv(description, order, coordinates, result.reshape(-1))
        return result

    return dexpinv


class Plan:
    """A frame and a method in compiled code.

    A frame in Python is called through callbacks. ``core`` is the compiled module, and ``address``
    that of the plan; ``width`` the number of doubles of a point, ``columns`` that of vectors of an
    interpolant. ``table`` is the table that compiled code reads: that of ``method``, or on a
    `LinearAction` that of one flow along a polynomial.
    """

    def __init__(self, frame: Frame, method: MethodTable) -> None:
        import cg._core_r64 as core

        self.core, self.frame, self.method = core, frame, method
        self.user_frame = frame._given or frame  # another one where f returns derivatives
        along = method.polynomial if isinstance(frame, LinearAction) else None
        self.table = table = method if along is None else along
        self.compiled = is_compiled(frame)
        self._has_difference = has_compiled_difference(frame)
        self.dtype, self.dim, self.point_shape = frame.dtype, frame.dim, frame.point_shape
        self.parts = 2 if self.dtype == np.complex128 else 1
        self.width = int(np.prod(frame.point_shape, dtype=np.int64)) * self.parts
        self.columns = table.output.columns
        if self.compiled:
            blocks = describe_blocks(frame)
        else:
            blocks = np.array([[BlockKind.CALLBACK], [frame.dim], [self.width]], dtype=np.intc)
        if table.is_polynomial or not table.explicit:
            provide_lapack()
        if table.is_polynomial:
            blocks[2] |= BlockOption.POLYNOMIAL
        self.address: int = core.plan_open(
            blocks, block_constants(frame), frame._given is not None, ctypes.addressof(table.record)
        )
        space: Any = frame  # a phase space, or that of points with derivatives
        if isinstance(frame, Product) and not isinstance(frame, PhaseSpace):
            space = frame.factors[0]
        if isinstance(space, PhaseSpace) and (table.kind is Kind.SPLITTING or space is frame):
            tangents = frame.dim // space.dim - 1
            core.plan_set_bodies(self.address, *space.compiled_bodies(), tangents)
        self._linkage = None
        if isinstance(space, PhaseSpace) and space.jointed:
            self._linkage = linkage_of(space)  # whose functions compiled code calls
            core.plan_share_joints(self.address, self._linkage.address)
        weakref.finalize(self, core.plan_close, self.address)
        output = table.output
        padded = np.pad(output.rows, ((0, 1), (0, 0)))  # arrays can't be empty
        core.plan_set_scheme(
            self.address, output.columns, table.on_algebra, output.final, output.series,
            np.append(output.theta, 0.0), padded.T, output.basis.T, table.is_polynomial,
            np.asfortranarray(output.node), np.asfortranarray(output.blend), output.flow_c,
            output.flow_weights.T,
        )  # fmt: skip

    def __reduce__(self) -> tuple[Any, ...]:
        # a method is sent by its name, so that each process has one instance with its cached data
        return plan_of, (self.frame, self.method)

    @property
    def impulses(self) -> int:
        """Number of vectors of impulses of joints that a step begins from."""
        splits = self.method.kind is Kind.SPLITTING and self._linkage is not None
        return 2 * len(self.table.arrays["origin"]) if splits else 0

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
        space = self.frame
        if not self.compiled or (isinstance(space, PhaseSpace) and space.has_conditions):
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


_MAX_PLANS = 64  # number that are kept for a frame
_MAX_FIELDS = 64  # largest dimension of a frame in Python whose rank is computed


def plan_of(frame: Frame, method: MethodTable) -> Plan:
    """Return the plan of a frame and a method, which is cached."""
    plans = _plans_on(frame)
    key = id(method), frame._given is None
    plan = plans.get(key)
    if plan is None:
        if len(plans) == _MAX_PLANS:
            plans.pop(next(iter(plans)), None)
        plan = plans[key] = Plan(frame, method)  # which keeps the method alive
    return plan


@cached_by_value
def _plans_on(frame: Frame) -> dict[tuple[int, bool], Plan]:
    return {}


@cached_by_value
def for_derivatives(frame: Frame) -> dict[bool, Frame]:
    """Return `Frame.for_derivatives` without and with brackets."""
    return {known: frame.for_derivatives(with_brackets=known) for known in (False, True)}


@cached_by_value
def has_brackets(frame: Frame) -> bool:
    """Return whether a frame has brackets of its fields."""
    try:
        frame.bracket(np.zeros(frame.dim), np.zeros(frame.dim))
    except NotImplementedError:
        return False
    return True


STAGE_SOLVERS = {"newton": int(StageLimit.NEWTON), "fixed-point": int(StageLimit.FIXED_POINT)}
"""The iterations for implicit stages, and their limits."""

# Newton's method takes fewer evaluations on the free rigid body at all step sizes: 9 instead of 11
# in a step where fixed-point corrections decrease by a factor of 20, 13 instead of 18 where by 5.
DEFAULT_STAGE_SOLVER = "newton"


class ConvergenceError(RuntimeError):
    """The stage equations of an implicit method were not solved.

    Attributes
    ----------
    reason
        What ended the iteration.
    iterations
        Iterations that were made.
    residual
        Largest residual of the stage equations, in the units of ``f``; NaN if it isn't known.
    t
        Time at which the step starts.
    h
        Signed step size.

    Examples
    --------
    A step so long that its stage equations have no solution:

    >>> import crouch_grossman as cg
    >>> try:
    ...     cg.integrate(
    ...         lambda t, y: 1.0 + y**2, (0, 4), [0.0], frame=cg.frames.Euclidean(1),
    ...         method="ImplicitMidpoint", h=4.0,
    ...     )
    ... except cg.ConvergenceError as error:
    ...     print(f"the step from t = {error.t:g} with h = {error.h:g}")
    the step from t = 0 with h = 4
    """

    def __init__(self, reason: str, iterations: int, residual: float, t: float, h: float) -> None:
        super().__init__(reason, iterations, residual, t, h)
        self.reason = reason
        self.iterations = iterations
        self.residual = residual
        self.t = t
        self.h = h

    def __str__(self) -> str:
        remainder = "" if math.isnan(self.residual) else f" the residual is {self.residual:.3g}"
        return (
            f"the implicit stages did not converge ({self.reason}): after {self.iterations} "
            f"iterations{remainder} in the step of h = {self.h:.6g} from t = {self.t:.17g}; "
            "a smaller step or another stage_solver may help"
        )
