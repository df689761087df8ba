"""Frames as compiled code takes them: arrays of blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame

__all__ = ["describe_blocks", "is_compiled"]

_KNOWN = "SO, SU, U, UnitQuaternion, SE3, Sphere(2), Euclidean and products of them"


def describe_blocks(frame: Frame) -> NDArray[np.int32]:
    """Return the blocks of a frame, shape ``(3, blocks)``; ValueError if it isn't compiled."""
    blocks = frame.compiled_blocks()
    if blocks is None:
        raise ValueError(f"frame must be one that is compiled, {_KNOWN}; {frame!r} is not")
    return np.array(blocks, dtype=np.int32, order="C").T


def is_compiled(frame: Frame) -> bool:
    """Tell whether compiled code has the flows of a frame."""
    return frame.compiled_blocks() is not None
