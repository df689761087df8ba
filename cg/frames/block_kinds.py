"""Frames as compiled code knows them: rows of blocks, each of a kind that has a number."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["SCALAR_FIRST", "SPACE_AXES", "BlockKind", "Blocks"]


class BlockKind(IntEnum):
    """What a block is; compiled code has the same numbers."""

    EUCLIDEAN = 1
    SO3 = 2
    QUATERNION = 3
    SE3 = 4
    SPHERE = 5
    SU2 = 6


SPACE_AXES = 1
"""Option of a block: its coefficients are in space axes."""

SCALAR_FIRST = 2
"""Option of a block: its quaternions begin with their scalar part."""

Blocks = tuple[tuple[int, int, int], ...]
"""Of every block its kind, the dimension of Euclidean space (3 elsewhere), and the sum of its
options."""


def axes_option(convention: str) -> int:
    """Return the option that stands for a convention."""
    return SPACE_AXES if convention == "space" else 0
