"""Descriptions of frames for compiled code: a frame is a sequence of blocks."""

from __future__ import annotations

from cg.frames.arrays import Array
from cg.support.shared_numbers import BlockKind, BlockOption

SPACE_AXES = int(BlockOption.SPACE_AXES)
"""Block option: coefficients are in space axes."""

SCALAR_FIRST = int(BlockOption.SCALAR_FIRST)
"""Block option: the scalar part of a quaternion comes first."""

Blocks = tuple[tuple[int, int, int, *tuple[float | Array, ...]], ...]
"""For each block: its `BlockKind`; its size n (of R^n, SO(n), SU(n) and U(n), the number of rows of
isospectral matrices, entries of the vector of a linear action, 3 for other kinds); the sum of its
options; and its constants, which are the increasing eigenvalues of isospectral matrices, or the
sparse matrices of a linear action."""

MAX_MATRIX = 12
"""Largest number of rows of compiled matrix groups; LAPACK is faster for larger ones."""


def convention_option(convention: str) -> int:
    """Return the block option of a convention."""
    return SPACE_AXES if convention == "space" else 0


def compared_by_entries(blocks: Blocks) -> bool:
    """Return whether a block has no coordinates, so that errors are measured in its entries."""
    return any(block[0] in (BlockKind.ISOSPECTRAL, BlockKind.LINEAR_ACTION) for block in blocks)
