"""Frames in compiled code: their blocks, and flows and dexp⁻¹ by them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.block_kinds import compared_by_entries, needs_lapack
from cg.frames.homogeneous import HomogeneousSpace
from cg.support.arrays import Array, Points
from cg.support.capsules import provide_lapack

Dexpinv = Callable[[Array, Array], Array]
"""``dexpinv(u, v)`` is `Frame.dexpinv`."""


def describe_blocks(frame: Frame) -> NDArray[np.int32]:
    """Return the blocks of a compiled frame, shape ``(3, blocks)``."""
    blocks = frame.compiled_blocks() or ()
    if any(needs_lapack(block) for block in blocks):
        provide_lapack()
    return np.array([block[:3] for block in blocks], dtype=np.int32, order="C").T


def block_constants(frame: Frame) -> NDArray[np.float64]:
    """Return the constants of all blocks of a frame, and a zero, since no array may be empty."""
    constants = [np.ravel(x) for block in frame.compiled_blocks() or () for x in block[3:]]
    return np.concatenate([*constants, [0.0]])


def is_compiled(frame: Frame) -> bool:
    """Return whether compiled code has the flows of a frame."""
    return frame.compiled_blocks() is not None


def has_compiled_difference(frame: Frame) -> bool:
    """Return whether compiled code computes the flow from one point to another."""
    blocks = frame.compiled_blocks()
    return blocks is not None and not compared_by_entries(blocks)


class Flows:
    """Moves points along several flows, in Python."""

    def __init__(self, frame: Frame) -> None:
        self.frame = frame

    def __call__(self, v: Array, y: Points, restore: bool = True) -> Points:
        """Return points moved along time-1 flows, the first one first.

        Coefficients have the shape ``(*batch, flows, dim)``, points ``(*batch, *point_shape)``.
        With ``restore`` rounding off the manifold is removed, if flows don't do so.
        """
        for j in range(v.shape[-2]):
            y = self.frame.flow(v[..., j, :], y)
        return y

    def restore(self, y: Points) -> Points:
        """Return points with rounding off the manifold removed, if flows don't do so."""
        return y


def flows_of(frame: Frame) -> Flows:
    """Return the function that moves points of a frame along flows."""
    if is_compiled(frame):
        return _CompiledFlows(frame)
    return _GroupFlows(frame) if _has_compiled_group(frame) else Flows(frame)


def dexpinv_of(frame: Frame, order: int) -> Dexpinv:
    """Return `Frame.dexpinv` for a method of some order."""
    import cg._core_r64 as core

    if _has_compiled_group(frame):
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


def _has_compiled_group(frame: Frame) -> TypeGuard[HomogeneousSpace]:
    """Return whether the group of a homogeneous space is compiled, and its action isn't."""
    return (
        isinstance(frame, HomogeneousSpace) and not is_compiled(frame) and is_compiled(frame.group)
    )


class _CompiledFlows(Flows):
    """Compiled flows; one call applies all of them, since a call takes longer than a flow."""

    def __init__(self, frame: Frame) -> None:
        import cg._core_r64 as core

        super().__init__(frame)
        self.move = core.frame_move
        self.blocks = describe_blocks(frame), block_constants(frame)

    def __call__(self, v: Array, y: Points, restore: bool = True) -> Points:
        moved = np.array(y, dtype=self.frame.dtype, order="C")
        if v.size and moved.size:
            fields = np.ascontiguousarray(v).reshape(-1)
            flat = moved.reshape(-1).view(np.float64)
            self.move(*self.blocks, v.shape[-2], fields, restore, flat)
        return moved

    def restore(self, y: Points) -> Points:
        return self(np.zeros((1, self.frame.dim)), y)


class _GroupFlows(Flows):
    """Flows of a homogeneous space: group elements are compiled, their action is in Python."""

    frame: HomogeneousSpace

    def __init__(self, frame: HomogeneousSpace) -> None:
        super().__init__(frame)
        self.group = _CompiledFlows(frame.group)
        self.identity = np.eye(frame.group.size, dtype=frame.group.dtype)

    def __call__(self, v: Array, y: Points, restore: bool = True) -> Points:
        start = self.identity
        if v.ndim > 2:
            start = np.broadcast_to(start, (*v.shape[:-2], *start.shape))
        moved = self.frame._act(self.group(v, start, restore=False), y)
        return self.restore(moved) if restore else moved

    def restore(self, y: Points) -> Points:
        return self.frame.restore(y)
