"""Frames as the compiled integrator knows them: rows of blocks."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cg.frames import SE3, SO, SO3, SU, Euclidean, Frame, Product, Sphere, UnitQuaternion


class BlockKind(IntEnum):
    """What a block is, by the numbers that fortran/frames.f90.in has for it."""

    EUCLIDEAN = 1
    SO3 = 2
    QUATERNION = 3
    SE3 = 4
    SPHERE = 5
    SU2 = 6


SPACE_AXES = 1
SCALAR_FIRST = 2

_CLASSES = (Euclidean, SO3, SO, UnitQuaternion, SE3, Sphere, SU)
_KNOWN = "SO3, UnitQuaternion, SU(2), SE3, Sphere(2), Euclidean and products of them"


def describe_blocks(frame: Frame) -> NDArray[np.int32]:
    """Return the blocks of a frame.

    Parameters
    ----------
    frame
        A frame that the compiled integrator has: SO(3) in either form, unit quaternions, SE(3),
        SU(2), the sphere in space, Euclidean space, or a product of these.

    Returns
    -------
    ndarray
        Kind, dimension of Euclidean space, and sum of options of every block, shape
        ``(3, blocks)``.

    Raises
    ------
    ValueError
        If there are other frames in it.
    """
    rows = _rows(frame)
    return np.array(rows, dtype=np.int32, order="C").T


def is_compiled(frame: Frame) -> bool:
    """Tell whether the compiled integrator has the flows of a frame: of this very class.

    A subclass may have other flows.
    """
    if type(frame) is Product:
        return all(map(is_compiled, frame.factors))
    if type(frame) not in _CLASSES:
        return False
    try:
        _rows(frame)
    except ValueError:
        return False
    return True


def _rows(frame: Frame) -> list[tuple[int, int, int]]:
    if isinstance(frame, Product):
        return [row for factor in frame.factors for row in _rows(factor)]
    match frame:
        case Euclidean():
            row = (BlockKind.EUCLIDEAN, frame.n, 0)
        case SO3() | SO(n=3):
            row = (BlockKind.SO3, 3, _axes(frame.convention))
        case UnitQuaternion():
            options = _axes(frame.convention) + (SCALAR_FIRST if frame.scalar_first else 0)
            row = (BlockKind.QUATERNION, 3, options)
        case SE3():
            row = (BlockKind.SE3, 3, _axes(frame.convention))
        case Sphere(n=2):
            row = (BlockKind.SPHERE, 3, 0)
        case SU(n=2):
            row = (BlockKind.SU2, 3, _axes(frame.convention))
        case _:
            raise ValueError(f"frame must be one that is compiled, {_KNOWN}; {frame!r} is not")
    return [row]


def _axes(convention: str) -> int:
    return SPACE_AXES if convention == "space" else 0
