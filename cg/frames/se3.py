"""Rigid motions of space, SE(3)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.matrix_group import MatrixGroup
from cg.frames.semidirect import Semidirect
from cg.frames.so3 import SO3
from cg.support.arrays import Convention, Points

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True, repr=False)
class SE3(Semidirect):
    r"""Poses :math:`\binom{R\;\;p}{0\;\;1}`, with twists as coefficients.

    The coefficients are the twist :math:`(\omega, v)`: angular velocity first, then linear
    velocity, :math:`\Omega = \binom{\hat\omega\;\;v}{0\;\;0}`. [1]_ and ``exp_coords`` of SciPy's
    ``RigidTransform`` use the same order; jaxlie uses :math:`(v, \omega)`.

    Points may also be given as SciPy's ``RigidTransform``.

    Parameters
    ----------
    convention
        ``"body"``: :math:`y' = y\,\Omega` (default), both velocities in body axes. ``"space"``:
        :math:`y' = \Omega\,y`; then :math:`v` is the velocity of the point of the body that
        passes through the origin.

    Notes
    -----
    The flow is the closed form of `Semidirect`, accurate for small angles too. The rotation is
    kept orthogonal as in `SO3` and the last row is exact. `distance` is the root of the squared
    angle (radians) and the squared distance of the positions added.

    References
    ----------
    .. [1] R. M. Murray, Z. Li, S. S. Sastry, *A Mathematical Introduction to Robotic
       Manipulation*, CRC Press, 1994, chapter 2.

    Examples
    --------
    A vehicle that moves forward on a half circle of radius 1:

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

    _blocks = Semidirect._blocks  # compiled too, see `Frame.compiled_blocks`

    def read_points(self, value: Any, name: str = "y") -> Points:
        """Return arrays of numbers, and the matrices of ``RigidTransform`` of SciPy."""
        # The first condition avoids the import of SciPy for plain arrays.
        if hasattr(value, "as_exp_coords") and isinstance(value, _rigid_transform()):
            return np.array(value.as_matrix(), dtype=np.float64, order="C")
        return super().read_points(value, name)

    def as_rigid_transform(self, y: ArrayLike) -> RigidTransform:
        """Return a point or a stack as ``scipy.spatial.transform.RigidTransform``.

        NotImplementedError if SciPy is older than version 1.16.
        """
        transform: RigidTransform = _rigid_transform().from_matrix(self._points(y))
        return transform


def _rigid_transform() -> Any:
    from scipy.spatial import transform

    try:
        return transform.RigidTransform
    except AttributeError:
        raise NotImplementedError("RigidTransform needs SciPy 1.16 or newer") from None
