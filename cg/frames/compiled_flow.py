"""Frames whose flow is that of compiled code."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import FlowOverflowError, Frame
from cg.frames.compiled import move
from cg.support.arrays import Array, Points


class CompiledFlow(Frame):
    """A frame of one compiled block, which has no flow in Python."""

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        vectors, points = self._rows(v, y)
        moved = points
        for block in self._blocks() or ():
            moved = move(block, vectors, points)
        # A cheap sufficient test
        if not math.isfinite(abs(moved.sum())):
            self._check_overflow(vectors, points, moved)
        return moved

    def _check_overflow(self, vectors: Array, points: Points, moved: Points) -> None:
        """Raise FlowOverflowError where the flow of finite coefficients and points isn't finite."""
        axes = tuple(range(vectors.ndim - 1, points.ndim))
        lost = ~np.isfinite(moved).all(axis=axes) & np.isfinite(points).all(axis=axes)
        lost &= np.isfinite(vectors).all(axis=-1)
        if lost.any():
            largest = np.abs(vectors[lost]).max()
            raise FlowOverflowError(
                f"the flow of v with |v| = {largest:.3g} can't be computed in double precision"
            )
