"""Frames in compiled code: blocks, whose flows, coordinates and dexp⁻¹ it computes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cg import _core_r64 as core
from cg.support.arrays import Array, Points
from cg.support.capsules import provide_lapack
from cg.support.shared_numbers import MAX_OWN_ROWS, BlockKind, BlockOption, Operation

_WITHOUT_COORDINATES = BlockKind.ISOSPECTRAL, BlockKind.LINEAR_ACTION, BlockKind.STIEFEL

Block = tuple[int, int, int, *tuple[float | Array, ...]]
Blocks = tuple[Block, ...]
"""For each block: its `BlockKind`; its size n (of R^n, SO(n), SU(n) and U(n), the number of rows of
isospectral matrices and of columns, of entries of the vector of a linear action, of translations
of SE(3), 3 for other kinds); the sum of its options; and its constants, which are the increasing
eigenvalues of isospectral matrices, the number of columns, or the matrices of a linear action."""

CLOSED_COORDINATES = BlockKind.SO3, BlockKind.SU2, BlockKind.SE3
"""Kinds of matrices whose coordinates have a closed form."""

_BY_LAPACK = BlockKind.STIEFEL, BlockKind.ISOSPECTRAL
_MATRICES = BlockKind.SO, BlockKind.SU, BlockKind.U


def needs_lapack(block: Block) -> bool:
    """Return whether compiled code calls BLAS and LAPACK for a block."""
    return block[0] in _BY_LAPACK or (block[0] in _MATRICES and block[1] > MAX_OWN_ROWS)


def convention_option(convention: str) -> int:
    """Return the block option of a convention."""
    return BlockOption.SPACE_AXES if convention == "space" else 0


def compared_by_entries(blocks: Blocks) -> bool:
    """Return whether a block has no coordinates, so that errors are measured in its entries."""
    return any(block[0] in _WITHOUT_COORDINATES for block in blocks)


def describe_blocks(blocks: Blocks) -> NDArray[np.int32]:
    """Return kinds, sizes and options of blocks, shape ``(3, blocks)``."""
    if any(map(needs_lapack, blocks)):
        provide_lapack()
    return _columns(*[block[:3] for block in blocks])


@lru_cache
def _columns(*blocks: tuple[int, int, int]) -> NDArray[np.int32]:
    return np.array(blocks, dtype=np.int32).T


def constants_of(blocks: Blocks) -> Array:
    """Return the constants of blocks, and a zero, since no array may be empty."""
    return np.concatenate([*[np.ravel(x) for block in blocks for x in block[3:]], [0.0]])


def apply_operation(
    operation: Operation, blocks: Blocks, option: int, count: int, *vectors: Points
) -> None:
    """Apply an operation to pairs of vectors in compiled code, which writes into the third ones."""
    rows = (np.ascontiguousarray(x).reshape(count, -1).view(np.float64).T for x in vectors)
    core.frame_apply(operation, describe_blocks(blocks), constants_of(blocks), option, *rows)


def move(block: Block, v: Array, y: Points) -> Points:
    """Return points moved along flows, not finite where compiled code can't compute them.

    Coefficients and points have the same leading axes. Rounding off the manifold is removed.
    """
    moved = np.empty_like(y, order="C", subok=False)
    if moved.size:
        apply_operation(Operation.FLOW, (block,), 1, v.size // v.shape[-1], v, y, moved)
    return moved


def coordinates_between(block: Block, dim: int, rank: int, y0: Points, y1: Points) -> Array:
    """Return the coefficients of flows between points of ``rank`` axes; leading axes broadcast."""
    if y0.shape != y1.shape:
        y0, y1 = np.broadcast_arrays(y0, y1)
    v = np.empty((*y0.shape[: y0.ndim - rank], dim))
    if v.size:
        apply_operation(Operation.COORDINATES, (block,), 0, v.size // dim, y0, y1, v)
    return v


def dexpinv(blocks: Blocks, u: Array, v: Array, order: int = 1) -> Array:
    """Return `Frame.dexpinv`; the order matters where it has no closed form."""
    if u.shape != v.shape:
        u, v = np.broadcast_arrays(u, v)
    result = np.empty(v.shape)
    if result.size:
        apply_operation(Operation.DEXPINV, blocks, order, v.size // v.shape[-1], u, v, result)
    return result
