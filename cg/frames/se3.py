"""Rigid motions of space, SE(3)."""

from __future__ import annotations

from dataclasses import dataclass, field

from cg.frames.arrays import Convention
from cg.frames.block_kinds import BlockKind, Blocks, axes_option
from cg.frames.matrix_group import MatrixGroup
from cg.frames.semidirect import Semidirect
from cg.frames.so3 import SO3


@dataclass(frozen=True, repr=False)
class SE3(Semidirect):
    r"""Poses :math:`\binom{R\;\;p}{0\;\;1}` moved by twists.

    The coefficients are the twist :math:`(\omega, v)`: angular velocity first, then linear
    velocity, :math:`\Omega = \binom{\hat\omega\;\;v}{0\;\;0}`.

    Parameters
    ----------
    convention
        ``"body"``: :math:`y' = y\,\Omega` (default), both velocities in body axes.  ``"space"``:
        :math:`y' = \Omega\,y`; then :math:`v` is the velocity of the point of the body that
        passes through the origin.

    Raises
    ------
    ValueError
        If ``convention`` is neither of the two.

    Notes
    -----
    The flow is the closed form of `Semidirect`, accurate for small angles too.  The rotation is
    kept orthogonal as in `SO3` and the last row is exact.  `distance` is the root of the squared
    angle (radians) and the squared distance of the positions added.

    References
    ----------
    .. [1] R. M. Murray, Z. Li, S. S. Sastry, *A Mathematical Introduction to Robotic
       Manipulation*, CRC Press, 1994, chapter 2.

    Examples
    --------
    A vehicle that goes forward and turns by half a circle ends beside its start.

    >>> import numpy as np
    >>> pose = SE3().flow(np.pi * np.array([0, 0, 1.0, 1.0, 0, 0]), np.eye(4))
    >>> pose[:3, 3].round(12)
    array([0., 2., 0.])
    """

    convention: Convention = "body"
    group: MatrixGroup = field(init=False)
    copies: int = field(default=1, init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "group", SO3(self.convention))

    def _blocks(self) -> Blocks | None:
        return ((BlockKind.SE3, 3, axes_option(self.convention)),)
