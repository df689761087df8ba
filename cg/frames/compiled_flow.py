"""Frames whose flow is that of compiled code."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import FlowOverflowError, Frame
from cg.frames.compiled import move
from cg.support.arrays import Points


class CompiledFlow(Frame):
    """A frame of one compiled block, which has no flow in Python."""

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        vectors, points = self._rows(v, y)
        (block,) = self._blocks() or ()
        moved = move(block, vectors, points)
        if math.isfinite(abs(moved.sum())):  # a cheap sufficient test
            return moved
        axes = tuple(range(vectors.ndim - 1, points.ndim))
        lost = ~np.isfinite(moved).all(axis=axes) & np.isfinite(points).all(axis=axes)
        lost &= np.isfinite(vectors).all(axis=-1)
        if lost.any():
            largest = np.abs(vectors[lost]).max()
            raise FlowOverflowError(
                f"the flow of v with |v| = {largest:.3g} can't be computed in double precision"
            )
        return moved
