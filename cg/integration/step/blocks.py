"""Descriptions of frames for compiled code: arrays of blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.block_kinds import compared_by_entries, needs_lapack
from cg.support.capsules import provide_lapack

_KNOWN = (
    "SO, SU, U, UnitQuaternion, SE3, Sphere(2), Euclidean and products of them, real "
    "IsospectralOrbit, LinearAction"
)


def describe_blocks(frame: Frame) -> NDArray[np.int32]:
    """Return the blocks of a frame, shape ``(3, blocks)``; ValueError if it isn't compiled."""
    blocks = frame.compiled_blocks()
    if blocks is None:
        raise ValueError(f"frame must be one that is compiled, {_KNOWN}; {frame!r} is not")
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
