"""Flows, and the flow from one point to another, as compiled code computes them."""

import numpy as np

import cg._core_r64 as core
from cg.integration.plan.plan import block_constants, describe_blocks, has_compiled_difference


def compiled_flows(frame):
    """Return a function that moves points, shape (..., *shape), along flows (..., count, dim)."""
    blocks = describe_blocks(frame), block_constants(frame)

    def move(v, y, restore=True):
        moved, fields = np.array(y, dtype=frame.dtype, order="C"), np.ascontiguousarray(v)
        flat = moved.reshape(-1).view(np.float64)
        core.frame_move(*blocks, v.shape[-2], fields.reshape(-1), restore, flat)
        return moved

    return move


def difference_of(frame):
    """Return `Frame.exp_coordinates`, compiled where possible."""
    if not has_compiled_difference(frame):
        return frame.exp_coordinates
    description, rank = describe_blocks(frame), len(frame.point_shape)

    def difference(y0, y1):
        v = np.empty((*y0.shape[: y0.ndim - rank], frame.dim))
        flat = (np.ascontiguousarray(y).reshape(-1).view(np.float64) for y in (y0, y1))
        core.frame_difference(description, *flat, v.reshape(-1))
        return v

    return difference
