"""Descriptions of frames for compiled code: a frame is a sequence of blocks."""

from __future__ import annotations

from cg.support.arrays import Array
from cg.support.shared_numbers import BlockKind, BlockOption

SPACE_AXES = int(BlockOption.SPACE_AXES)
"""Block option: coefficients are in space axes."""

_WITHOUT_COORDINATES = BlockKind.ISOSPECTRAL, BlockKind.LINEAR_ACTION, BlockKind.STIEFEL

SCALAR_FIRST = int(BlockOption.SCALAR_FIRST)
"""Block option: the scalar part of a quaternion comes first."""

Block = tuple[int, int, int, *tuple[float | Array, ...]]
Blocks = tuple[Block, ...]
"""For each block: its `BlockKind`; its size n (of R^n, SO(n), SU(n) and U(n), the number of rows of
isospectral matrices, entries of the vector of a linear action, translations of SE(3), rows of
columns, 3 for other kinds); the sum of its
options; and its constants, which are the increasing eigenvalues of isospectral matrices, or the
sparse matrices of a linear action."""

CLOSED_FORMS = BlockKind.SO3, BlockKind.SU2, BlockKind.SE3
"""Kinds of matrices whose coordinates have a closed form."""

_MATRICES = BlockKind.SO, BlockKind.SU, BlockKind.U, BlockKind.ISOSPECTRAL

MAX_MATRIX = 12
"""Largest number of rows of matrices that compiled code multiplies without BLAS."""


def needs_lapack(block: Block) -> bool:
    """Return whether compiled code calls BLAS and LAPACK for a block."""
    return block[0] == BlockKind.STIEFEL or (block[0] in _MATRICES and block[1] > MAX_MATRIX)


def convention_option(convention: str) -> int:
    """Return the block option of a convention."""
    return SPACE_AXES if convention == "space" else 0


def compared_by_entries(blocks: Blocks) -> bool:
    """Return whether a block has no coordinates, so that errors are measured in its entries."""
    return any(block[0] in _WITHOUT_COORDINATES for block in blocks)
