"""Flows, differences and dexp⁻¹ of frames, compiled where possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeGuard

import numpy as np

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.frames.homogeneous import HomogeneousSpace
from cg.integration.step.blocks import (
    block_constants,
    describe_blocks,
    has_compiled_difference,
    is_compiled,
)


class Flows(Protocol):
    """Moves points along several flows."""

    def __call__(self, v: Array, y: Points, restore: bool = True) -> Points:
        """Return points moved along time-1 flows, the first one first.

        Coefficients have the shape ``(*batch, flows, dim)``, points ``(*batch, *point_shape)``.
        With ``restore`` rounding off the manifold is removed, if flows don't do so.
        """
        ...

    def restore(self, y: Points) -> Points:
        """Return points with rounding off the manifold removed, if flows don't do so."""
        ...


Difference = Callable[[Points, Points], Array | None]
"""``difference(y0, y1)`` is `Frame.exp_coordinates`."""


Dexpinv = Callable[[Array, Array], Array]
"""``dexpinv(u, v)`` is `Frame.dexpinv`."""


def flows_of(frame: Frame) -> Flows:
    """Return the function that moves points of a frame along flows."""
    if is_compiled(frame):
        return _CompiledFlows(frame)
    return _GroupFlows(frame) if _has_compiled_group(frame) else _Flows(frame)


def difference_of(frame: Frame) -> Difference:
    """Return the function that computes the flow from one point to another."""
    return _CompiledDifference(frame) if has_compiled_difference(frame) else frame.exp_coordinates


def dexpinv_of(frame: Frame, order: int) -> Dexpinv:
    """Return `Frame.dexpinv` for a method of some order."""
    if _has_compiled_group(frame):
        frame = frame.group
    return _CompiledDexpinv(frame, order) if is_compiled(frame) else _Dexpinv(frame, order)


def _has_compiled_group(frame: Frame) -> TypeGuard[HomogeneousSpace]:
    """Return whether the group of a homogeneous space is compiled, and its action isn't."""
    return (
        isinstance(frame, HomogeneousSpace) and not is_compiled(frame) and is_compiled(frame.group)
    )


class _Dexpinv:
    def __init__(self, frame: Frame, order: int) -> None:
        self.frame = frame
        self.order = order

    def __call__(self, u: Array, v: Array) -> Array:
        return self.frame.dexpinv(u, v, order=self.order)


class _Flows:
    def __init__(self, frame: Frame) -> None:
        self.frame = frame

    def __call__(self, v: Array, y: Points, restore: bool = True) -> Points:
        for j in range(v.shape[-2]):
            y = self.frame.flow(v[..., j, :], y)
        return y

    def restore(self, y: Points) -> Points:
        return y


class _CompiledFlows:
    """Compiled flows; one call applies all of them, since a call takes longer than a flow."""

    def __init__(self, frame: Frame) -> None:
        import cg._core_r64 as core

        self.frame = frame
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


class _GroupFlows:
    """Flows of a homogeneous space: group elements are compiled, their action is in Python."""

    def __init__(self, frame: HomogeneousSpace) -> None:
        self.frame = frame
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


class _CompiledDifference:
    def __init__(self, frame: Frame) -> None:
        import cg._core_r64 as core

        self.frame = frame
        self.difference = core.frame_difference
        self.description = describe_blocks(frame)

    def __call__(self, y0: Points, y1: Points) -> Array:
        rank = len(self.frame.point_shape)
        v = np.empty((*y0.shape[: y0.ndim - rank], self.frame.dim))
        if v.size:
            self.difference(self.description, _flat(y0), _flat(y1), v.reshape(-1))
        return v


class _CompiledDexpinv:
    def __init__(self, frame: Frame, order: int) -> None:
        import cg._core_r64 as core

        self.frame = frame
        self.order = order
        self.dexpinv = core.frame_dexpinv
        self.description = describe_blocks(frame)

    def __call__(self, u: Array, v: Array) -> Array:
        result = np.array(v, order="C")
        if result.size:
            coordinates = np.ascontiguousarray(u).reshape(-1)
            self.dexpinv(self.description, self.order, coordinates, result.reshape(-1))
        return result


def _flat(y: Points) -> Array:
    return np.ascontiguousarray(y).reshape(-1).view(np.float64)
