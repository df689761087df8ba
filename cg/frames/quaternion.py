"""Unit quaternions as the configuration of a rotating body."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import CompiledFlow
from cg.frames.blocks import Blocks, convention_option, coordinates_between
from cg.frames.orthonormal import UnitVectors
from cg.frames.rotations import is_rotation
from cg.support.arrays import CONVENTIONS, Array, Convention, Points
from cg.support.checks import check_choice, check_flag
from cg.support.shared_numbers import BlockKind, BlockOption

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True, repr=False)
class UnitQuaternion(CompiledFlow, UnitVectors):
    r"""Unit quaternions, with angular velocities in body or space axes as coefficients.

    A quaternion represents the same rotation as in ``scipy.spatial.transform.Rotation``, and the
    coefficients are those of `SO3` with the same convention. ``q`` and ``-q`` are the same
    rotation, but different points.

    Parameters
    ----------
    convention
        ``"body"``: :math:`q' = \tfrac12\, q \otimes v` (default), ``"space"``:
        :math:`q' = \tfrac12\, v \otimes q`.
    scalar_first
        Whether a point is ``(w, x, y, z)`` instead of ``(x, y, z, w)``.

    Notes
    -----
    The fields are linear, :math:`q' = G(v) q` with :math:`G(v)^2 = -\tfrac14 |v|^2`, so that the
    flow is :math:`q \cos x + G(v) q\,\sin(x) / x` with :math:`x = |v| / 2` [1]_. A last step
    towards length one removes rounding errors.

    References
    ----------
    .. [1] J. B. Kuipers, *Quaternions and Rotation Sequences*, Princeton University Press, 1999.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.spatial.transform import Rotation
    >>> q = UnitQuaternion().flow([0.0, 0.0, np.pi / 2], [0.0, 0.0, 0.0, 1.0])
    >>> Rotation.from_quat(q).apply([1.0, 0.0, 0.0]).round(15) + 0.0
    array([0., 1., 0.])
    """

    convention: Convention = "body"
    scalar_first: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        check_choice("convention", self.convention, CONVENTIONS)
        object.__setattr__(self, "scalar_first", check_flag("scalar_first", self.scalar_first))

    @property
    def dim(self) -> int:
        return 3

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (4,)

    def field(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._arguments(v, y)
        x, w = point[..., :3], point[..., 3:]
        if self.scalar_first:
            w, x = point[..., :1], point[..., 1:]
        real = -np.vecdot(vector, x)[..., None]
        imaginary = w * vector + self._rotation_sign * np.cross(vector, x)
        parts = [real, imaginary] if self.scalar_first else [imaginary, real]
        return 0.5 * np.concatenate(parts, axis=-1)

    def _coefficients_at(self, y: Array, tangent: Array) -> Array:
        # The fields are orthogonal, with half the length of the point.
        fields = self.field(np.eye(3), y[:, None])
        return np.asarray(4.0 * np.vecdot(fields, tangent[:, None]) / np.vecdot(y, y)[:, None])

    def _logarithms(self, m: Array, y: Array) -> Array:
        # Attitudes that are farther apart are nearer with the other sign.
        return np.where((np.vecdot(y, m) > 0.0)[..., None], super()._logarithms(m, y), np.nan)

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        r"""Return the angle in radians that turns ``x`` into ``y``, at most :math:`2\pi`.

        It is the distance of points, :math:`2\pi` for ``q`` and ``-q``; `attitude_difference` is
        that of the rotations that they represent.
        """
        return np.asarray(4.0 * np.arcsin(np.minimum(super().distance(x, y) / 2.0, 1.0)))

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        r"""Return the rotation vector from ``y0`` to ``y1``, of length at most :math:`2\pi`.

        Its flow ends at ``y1``, even where ``-y1`` is nearer; see `attitude_difference`.
        """
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        return coordinates_between(self._blocks()[0], 3, 1, start, end)

    def attitude_difference(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        r"""Return the shortest rotation vector from one attitude to another.

        Attitudes are the rotations that points represent: ``q`` and ``-q`` are the same one. The
        vector, of length at most :math:`\pi` radians, is in body or space axes as coefficients are,
        and its flow from ``y0`` ends at ``y1`` or ``-y1``. Use it for errors of attitudes, such as
        residuals of measurements.

        Examples
        --------
        >>> q = UnitQuaternion().flow([0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0])
        >>> UnitQuaternion().attitude_difference([0.0, 0.0, 0.0, 1.0], -q).round(12)
        array([0. , 0. , 0.5])
        """
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        opposite = np.vecdot(start, end) < 0.0
        return self.exp_coordinates(start, np.where(opposite[..., None], -end, end))

    def _blocks(self) -> Blocks:
        scalar_option = BlockOption.SCALAR_FIRST if self.scalar_first else 0
        return ((BlockKind.QUATERNION, 3, convention_option(self.convention) + scalar_option),)

    def read_points(self, value: Any, name: str = "y") -> Points:
        """Return arrays of numbers, and the quaternions of ``Rotation`` of SciPy."""
        if is_rotation(value):
            quaternions = value.as_quat(scalar_first=self.scalar_first)
            return np.array(quaternions, dtype=np.float64, order="C")
        return super().read_points(value, name)

    def as_rotation(self, y: ArrayLike) -> Rotation:
        """Return a point or a stack as ``scipy.spatial.transform.Rotation``."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self._points(y), scalar_first=self.scalar_first)
