"""Frames as compiled code knows them: rows of blocks, each of a kind that has a number."""

from __future__ import annotations

from cg.support.shared_numbers import BlockKind, BlockOption

__all__ = ["SCALAR_FIRST", "SPACE_AXES", "BlockKind", "Blocks", "compared_by_entries"]

SPACE_AXES = int(BlockOption.SPACE_AXES)
"""Option of a block: its coefficients are in space axes."""

SCALAR_FIRST = int(BlockOption.SCALAR_FIRST)
"""Option of a block: its quaternions begin with their scalar part."""

Blocks = tuple[tuple[int, int, int, *tuple[float, ...]], ...]
"""Of every block its kind, its size n (of R^n, SO(n), SU(n), U(n), rows of isospectral matrices; 3
elsewhere), the sum of its options, and what constants it has: eigenvalues, increasing."""

MAX_MATRIX = 12
"""Up to this size the flows of matrix groups are compiled; beyond, libraries are faster."""


def axes_option(convention: str) -> int:
    """Return the option that stands for a convention."""
    return SPACE_AXES if convention == "space" else 0


def compared_by_entries(blocks: Blocks) -> bool:
    """Tell whether some points are compared by their entries, for want of coordinates."""
    return any(block[0] == BlockKind.ISOSPECTRAL for block in blocks)
