"""The rotation groups SO(n) and SO(3) and rigid motions SE(3), as matrices; the hat map."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.blocks import Blocks, convention_option
from cg.frames.matrix_functions import rotation_log1p
from cg.frames.matrix_group import MAX_DENSE, Entries, MatrixGroup, entries_of
from cg.frames.matrix_groups import SizedMatrixGroup, UnitaryMatrixGroup
from cg.frames.semidirect import Semidirect
from cg.support.arrays import Array, Convention, Points, Size, check_random, real_array
from cg.support.shared_numbers import BlockKind

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform, Rotation


def is_rotation(value: Any) -> TypeGuard[Rotation]:
    """Return whether a value is a ``Rotation`` of SciPy."""
    # Avoids the slow import for plain arrays
    if not hasattr(value, "as_quat"):
        return False
    from scipy.spatial.transform import Rotation

    return isinstance(value, Rotation)


def hat(v: ArrayLike) -> Array:
    r"""Return the skew matrices, ``(..., 3, 3)``, of vectors: :math:`\hat v\, x = v \times x`.

    Examples
    --------
    >>> hat([0.0, 0.0, 1.0]) @ [1.0, 0.0, 0.0]
    array([0., 1., 0.])
    """
    vector = real_array(v, "v")
    if vector.ndim == 0 or vector.shape[-1] != 3:
        raise ValueError(f"v must have shape (..., 3), got {vector.shape}")
    # Explicit placement, not a product with the generators: 0 * inf must not spread NaN.
    matrix = np.zeros((*vector.shape[:-1], 3, 3))
    matrix[..., 2, 1] = vector[..., 0]
    matrix[..., 0, 2] = vector[..., 1]
    matrix[..., 1, 0] = vector[..., 2]
    return matrix - np.swapaxes(matrix, -1, -2)


def vee(matrix: ArrayLike) -> Array:
    """Return the vectors, ``(..., 3)``, whose ``hat`` is the skew part of ``matrix``.

    The symmetric part is dropped, while `SO3.vee` refuses matrices that have one.

    Examples
    --------
    >>> vee(hat([1.0, 2.0, 3.0]))
    array([1., 2., 3.])
    """
    m = real_array(matrix, "matrix")
    if m.shape[-2:] != (3, 3):
        raise ValueError(f"matrix must have shape (..., 3, 3), got {m.shape}")
    above = np.stack([m[..., 1, 2], m[..., 2, 0], m[..., 0, 1]], axis=-1)
    below = np.stack([m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]], axis=-1)
    return np.asarray(0.5 * (below - above))


@dataclass(frozen=True, repr=False)
class SO(UnitaryMatrixGroup, SizedMatrixGroup):
    r"""Rotations of :math:`R^n`: orthogonal matrices of determinant 1.

    The coefficients are the entries :math:`(-1)^{i+j+1}\,\Omega_{ji}` of the skew matrix
    :math:`\Omega` for all pairs :math:`i < j`, the last pair first. With these signs the
    coefficients of ``SO(3)`` are the rotation vector, as for `SO3`, and that of ``SO(2)`` is the
    angle.

    Parameters
    ----------
    n
        Number of rows, at least 2.

    Notes
    -----
    The exponential is a closed form for n = 2 and 3, and computed as for `U` otherwise. Every pair
    of points has `exp_coordinates`: a closed form there too, otherwise from the real Schur form.
    Each flow ends with a step towards the group that removes rounding errors [1]_.

    References
    ----------
    .. [1] N. J. Higham, *Functions of Matrices*, SIAM, 2008, section 8.3.

    Examples
    --------
    >>> import numpy as np
    >>> SO(4).dim
    6
    >>> SO(2).flow([np.pi / 2], np.eye(2)).round(15) + 0.0
    array([[ 0., -1.],
           [ 1.,  0.]])
    """

    convention: Convention = "body"

    min_n: ClassVar[int] = 2
    _special: ClassVar[bool] = True

    @property
    def dim(self) -> int:
        return self.n * (self.n - 1) // 2

    def _make_basis(self) -> Entries:
        i, j = (indices[::-1] for indices in np.triu_indices(self.n, 1))
        sign = np.where((i + j) % 2, 1.0, -1.0)
        return entries_of(self.n, (j, i, sign), (i, j, -sign))

    # Right-hand sides convert a matrix at each stage; for many rows this is faster than products
    # with sparse matrices.
    @cached_property
    def _indices(self) -> tuple[Any, Any, Array]:
        """The flat indices of each coefficient below and above the diagonal, and signs."""
        entries = self._make_basis()
        below, above = entries.indices.reshape(2, -1)
        return below, above, entries.values[: self.dim]

    def _combine(self, v: Array) -> Points:
        if self.n <= MAX_DENSE:
            return super()._combine(v)
        below, above, signs = self._indices
        flat = np.zeros((*v.shape[:-1], self.n**2))
        flat[..., below] = signs * v
        flat[..., above] = -signs * v
        return flat.reshape(*v.shape[:-1], *self.point_shape)

    def _algebra_projection(self, matrices: Points) -> Array:
        if self.n <= MAX_DENSE:
            return super()._algebra_projection(matrices)
        below, above, signs = self._indices
        flat = matrices.reshape(*matrices.shape[:-2], self.n**2)
        return np.asarray(0.5 * signs * (flat.take(below, -1) - flat.take(above, -1)))

    def _log1p(self, difference: Points) -> Array:
        # Angles are at most pi.
        return self._algebra_projection(rotation_log1p(difference))

    def _blocks(self) -> Blocks | None:
        kind = BlockKind.SO3 if self.n == 3 else BlockKind.SO
        return ((kind, self.n, convention_option(self.convention)),)

    def read_points(self, value: Any, name: str = "y") -> Points:
        """Return arrays of numbers, and for n = 3 the matrices of ``Rotation`` of SciPy."""
        if self.n == 3 and is_rotation(value):
            return np.array(value.as_matrix(), dtype=np.float64, order="C")
        return super().read_points(value, name)

    def as_rotation(self, y: ArrayLike) -> Rotation:
        """Return a point or a stack, n = 3 only, as ``scipy.spatial.transform.Rotation``."""
        if self.n != 3:
            raise ValueError(f"n must be 3 for as_rotation, got {self!r}")
        from scipy.spatial.transform import Rotation

        return Rotation.from_matrix(np.array(self._points(y)))  # SciPy 1.15 wants it writeable


@dataclass(frozen=True, repr=False)
class SO3(SO):
    r"""Rotation matrices with the frame of left- or right-invariant vector fields.

    Parameters
    ----------
    convention
        ``"body"``: :math:`y' = y\,\hat v`, coefficients are an angular velocity in body axes.
        ``"space"``: :math:`y' = \hat v\, y`, coefficients are in space axes.

    Notes
    -----
    The exponential is the rotation of a unit quaternion. Each flow ends with a step towards the
    group that removes rounding errors, as in `SO`.

    Examples
    --------
    A quarter of a turn about the third axis of the body, or of space:

    >>> import numpy as np
    >>> upright = SO3().flow([np.pi / 2, 0.0, 0.0], np.eye(3))
    >>> SO3("body").flow([0.0, 0.0, np.pi / 2], upright).round(15) + 0.0
    array([[ 0., -1.,  0.],
           [ 0.,  0., -1.],
           [ 1.,  0.,  0.]])
    >>> SO3("space").flow([0.0, 0.0, np.pi / 2], upright).round(15) + 0.0
    array([[0., 0., 1.],
           [1., 0., 0.],
           [0., 1., 0.]])
    """

    n: int = field(default=3, init=False)

    def algebra(self, v: ArrayLike) -> Points:
        """Return ``hat(v)``, shape ``(..., 3, 3)``."""
        return hat(self._vectors(v))

    _blocks = SO._blocks  # compiled too, see `Frame.compiled_blocks`

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        r"""Return the angle in radians between two rotations, shape ``(...)``.

        It is :math:`2\arcsin(\|x - y\|_F / \sqrt 8)`, which unlike the arc cosine of a trace is
        accurate for nearly equal rotations.
        """
        return np.asarray(2.0 * np.arcsin(np.minimum(super().distance(x, y) / np.sqrt(8.0), 1.0)))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return rotations uniform in Haar measure, shape ``(*size, 3, 3)``."""
        size = check_random(rng, size)
        q = rng.standard_normal((*size, 4))
        q /= np.linalg.norm(q, axis=-1, keepdims=True)
        w, axis = q[..., :1, None], q[..., 1:]
        outer = axis[..., :, None] * axis[..., None, :]
        return np.asarray((2.0 * w**2 - 1.0) * np.eye(3) + 2.0 * (outer + w * hat(axis)))


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
        if hasattr(value, "as_exp_coords"):
            return np.array(value.as_matrix(), dtype=np.float64, order="C")
        return super().read_points(value, name)

    def as_rigid_transform(self, y: ArrayLike) -> RigidTransform:
        """Return a point or a stack as SciPy's ``RigidTransform``, which SciPy 1.16 brought."""
        from scipy.spatial.transform import RigidTransform

        return RigidTransform.from_matrix(self._points(y))
