"""Frames in compiled code: their blocks, and dexp⁻¹ by them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.block_kinds import compared_by_entries, needs_lapack
from cg.frames.coadjoint import CoadjointOrbit
from cg.frames.euclidean import Euclidean
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.power import Power
from cg.frames.product import Product
from cg.frames.semidirect import Semidirect
from cg.support.arrays import Array
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
    inner: Any = None
    if isinstance(frame, Semidirect | CoadjointOrbit):
        inner = frame.group if isinstance(frame, Semidirect) else frame.algebra
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
