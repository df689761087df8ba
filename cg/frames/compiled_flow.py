"""Frames whose flow is that of compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import FlowOverflowError, Frame
from cg.frames.block_kinds import needs_lapack
from cg.support.arrays import Array, Points
from cg.support.capsules import provide_lapack


class CompiledFlow(Frame):
    """A frame of one compiled block, which has no flow in Python."""

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        import cg._core_r64 as core

        vectors, points = self._rows(v, y)
        moved = points.copy()
        for block in self._blocks() or ():
            if needs_lapack(block):
                provide_lapack()
            description = np.array([block[:3]], dtype=np.int32).T
            constants = np.concatenate([np.ravel(x) for x in block[3:]])
            flat = moved.reshape(-1).view(np.float64)
            if moved.size:
                core.frame_move(description, constants, 1, vectors.reshape(-1), True, flat)
        axes = tuple(range(vectors.ndim - 1, points.ndim))
        lost = ~np.isfinite(moved).all(axis=axes) & np.isfinite(points).all(axis=axes)
        lost &= np.isfinite(vectors).all(axis=-1)
        if lost.any():
            largest = np.abs(vectors[lost]).max()
            raise FlowOverflowError(
                f"the flow of v with |v| = {largest:.3g} can't be computed in double precision"
            )
        return moved

    def _rows(self, v: ArrayLike, y: ArrayLike) -> tuple[Array, Points]:
        """Return contiguous coefficients and points with the same leading axes."""
        vectors, points = self._arguments(v, y)
        axes = points.ndim - len(self.point_shape)
        lead = np.broadcast_shapes(vectors.shape[:-1], points.shape[:axes])
        return (
            np.ascontiguousarray(np.broadcast_to(vectors, (*lead, self.dim))),
            np.ascontiguousarray(np.broadcast_to(points, (*lead, *self.point_shape)), self.dtype),
        )
