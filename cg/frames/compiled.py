"""Calls of compiled code for the flows, coordinates and dexp⁻¹ of one block of a frame."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cg.frames.block_kinds import Block, needs_lapack
from cg.support.arrays import Array, Points
from cg.support.capsules import provide_lapack


@lru_cache
def _description(kind: int, n: int, options: int) -> NDArray[np.int32]:
    return np.array([[kind], [n], [options]], dtype=np.int32)


def _flat(array: Points) -> Array:
    return np.ascontiguousarray(array).reshape(-1).view(np.float64)


def move(block: Block, v: Array, y: Points) -> Points:
    """Return points moved along flows, not finite where compiled code can't compute them.

    Coefficients and points have the same leading axes. Rounding off the manifold is removed.
    """
    import cg._core_r64 as core

    if needs_lapack(block):
        provide_lapack()
    moved = np.array(y, order="C")
    if moved.size:
        constants = np.concatenate([*map(np.ravel, block[3:]), [0.0]])  # never empty
        core.frame_move(_description(*block[:3]), constants, 1, _flat(v), True, _flat(moved))
    return moved


def coordinates_between(block: Block, dim: int, rank: int, y0: Points, y1: Points) -> Array:
    """Return the coefficients of flows between points of ``rank`` axes; leading axes broadcast."""
    import cg._core_r64 as core

    if y0.shape != y1.shape:
        y0, y1 = np.broadcast_arrays(y0, y1)
    v = np.empty((*y0.shape[: y0.ndim - rank], dim))
    if v.size:
        core.frame_difference(_description(*block[:3]), _flat(y0), _flat(y1), _flat(v))
    return v


def dexpinv(block: Block, u: Array, v: Array) -> Array:
    """Return the closed form of `Frame.dexpinv` for a block of rotations or motions."""
    import cg._core_r64 as core

    if u.shape != v.shape:
        u, v = np.broadcast_arrays(u, v)
    result = np.array(v, order="C")
    if result.size:
        core.frame_dexpinv(_description(*block[:3]), 1, _flat(u), _flat(result))
    return result
