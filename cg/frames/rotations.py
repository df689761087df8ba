"""Rotations of space: the hat map, and those of SciPy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from cg.support.arrays import Array, real_array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


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
