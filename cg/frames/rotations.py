"""Closed forms for rotations of space: exponentials, logarithms, and the hat map."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from cg.support.arrays import Array, real_array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_SMALLEST = float(np.finfo(np.float64).tiny)

# hat(v) is the contraction of v with these three generators, one row each.
_GENERATORS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]],
    dtype=np.float64,
)

# (x - sin x) / x^3 in powers of -x^2, enough of them for |x| <= 1.
_SERIES = [1.0 / math.factorial(2 * k + 3) for k in range(9)]


def is_rotation(value: Any) -> TypeGuard[Rotation]:
    """Return whether a value is a ``Rotation`` of SciPy."""
    # Avoids the slow import for plain arrays
    if not hasattr(value, "as_quat"):
        return False
    from scipy.spatial.transform import Rotation

    return isinstance(value, Rotation)


def hat(v: ArrayLike) -> Array:
    r"""Return the skew matrix with :math:`\hat v\, x = v \times x`.

    Parameters
    ----------
    v
        Vectors, shape ``(..., 3)``.

    Returns
    -------
    ndarray
        Matrices, shape ``(..., 3, 3)``.

    Raises
    ------
    ValueError
        If the last axis of ``v`` hasn't length 3.

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
    """Return the vector whose ``hat`` is the skew part of ``matrix``.

    Parameters
    ----------
    matrix
        Shape ``(..., 3, 3)``.

    Returns
    -------
    ndarray
        Shape ``(..., 3)``.

    Raises
    ------
    ValueError
        If the trailing shape isn't ``(3, 3)``.

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


def half_angle(v: Array) -> tuple[Array, Array]:
    r"""Return :math:`x = |v| / 2` and :math:`\sin(x) / x`, each of shape ``(...)``.

    The quotient is accurate to one or two rounding errors for every nonzero angle, in any
    precision, so that no series is needed.
    """
    # At the smallest number the quotient is exactly 1, its limit at zero.
    half = np.maximum(0.5 * np.sqrt(np.vecdot(v, v)), _SMALLEST)
    return half, np.sin(half) / half


def rotate(v: Array, columns: Array) -> Array:
    r"""Return :math:`e^{\hat v}` times the columns of a ``(..., 3, k)`` array.

    The formula is Rodrigues', with half angles:
    :math:`e^{\hat v} = I + u \cos x\,\hat v + \tfrac12 u^2 \hat v^2`,
    :math:`x = |v| / 2`, :math:`u = \sin(x) / x`.
    """
    generator = (v @ _GENERATORS).reshape(*v.shape[:-1], 3, 3)
    half, sinc = half_angle(v)
    half, sinc = half[..., None, None], sinc[..., None, None]
    first = generator @ columns
    second = generator @ first
    return np.asarray(columns + sinc * (np.cos(half) * first + (0.5 * sinc) * second))


def averaged_rotation(v: Array, columns: Array) -> Array:
    r"""Return :math:`\int_0^1 e^{s\hat v}\,ds` times the columns of a ``(..., 3, k)`` array.

    The integral is :math:`I + \tfrac12 u^2 \hat v + \frac{\theta - \sin\theta}{\theta^3}
    \hat v^2` with :math:`\theta = |v|` and :math:`u = \sin(\theta/2) / (\theta/2)`. The last
    quotient cancels for small angles; up to one radian its Taylor series is summed instead.
    """
    generator = hat(v)
    half, sinc = half_angle(v)
    angle = 2.0 * half
    square = np.minimum(angle * angle, 1.0)
    series = np.full_like(square, _SERIES[-1])
    for coefficient in _SERIES[-2::-1]:
        series = coefficient - square * series
    large = np.maximum(angle, 1.0)
    third = np.where(angle < 1.0, series, (large - np.sin(large)) / large**3)
    first = generator @ columns
    second = generator @ first
    return np.asarray(
        columns + (0.5 * sinc * sinc)[..., None, None] * first + third[..., None, None] * second
    )


def quaternion_logarithm(vector: Array, scalar: Array) -> Array:
    r"""Return the rotation vector :math:`v` with :math:`e^{v/2}` = (vector, scalar).

    Its length is at most :math:`2\pi`. The axis of the quaternion -1, which is not unique, is the
    first one.
    """
    sine = np.sqrt(np.vecdot(vector, vector))
    half = np.arctan2(sine, scalar)
    quotient = np.divide(half, sine, out=np.ones_like(half), where=sine > 0.0)
    logarithm = 2.0 * quotient[..., None] * vector
    opposite = (sine == 0.0) & (scalar < 0.0)
    logarithm[..., 0] = np.where(opposite, 2.0 * np.pi, logarithm[..., 0])
    return logarithm


def rotation_logarithm(difference: Array) -> Array:
    r"""Return rotation vectors, at most :math:`\pi` long, of rotation matrices less the identity.

    It computes the quaternion, its component of largest modulus first (Shepperd, J. Guidance
    Control 1 (1978), 223-224), and is equally accurate near the identity and near half a turn.
    """
    trace = np.trace(difference, axis1=-2, axis2=-1)
    diagonal = np.diagonal(difference, axis1=-2, axis2=-1)
    axial = 2.0 * vee(difference)
    # Four times the outer product of the quaternion (vector, scalar) with itself.
    outer = np.empty((*difference.shape[:-2], 4, 4))
    outer[..., :3, :3] = difference + difference.mT
    for i in range(3):
        outer[..., i, i] = 2.0 * diagonal[..., i] - trace
    outer[..., :3, 3] = outer[..., 3, :3] = axial
    outer[..., 3, 3] = 4.0 + trace
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    return quaternion_logarithm(q[..., :3], q[..., 3])
