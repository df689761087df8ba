"""Functions of stacked matrices: exponentials, projections, restoring steps, and logarithms."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy

from cg.frames.base import FlowOverflowError
from cg.support.arrays import Array, Points

MAX_EXPONENT = 2.0**32
"""The largest norm of a matrix whose exponential is computed.

For any algorithm the error is the norm times the rounding unit, times a factor of up to 60 in the
tests. Restoring squares the distance from the manifold, to 5e-9 at this norm; for larger norms it
would exceed the tolerance for points.
"""

_MAX_CORRECTIONS = 10  # Newton steps
_MIN_CORRECTION = 1e-15  # relative to the points; a smaller one is rounding


def expm(matrix: Points, v: Array) -> Points:
    """Return the exponentials of square matrices, not finite where they overflow.

    They are accurate to a few roundings times the norm of the matrices. SciPy's Padé approximant
    preserves quadratic groups such as the symplectic one, which matters where points grow.
    FlowOverflowError, which names ``v``, for a norm greater than `MAX_EXPONENT`.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        # SciPy's exponential is accurate up to norm 1, but loses two digits at norm 3 and four at
        # norm 10. Scaling and squaring of larger matrices avoids that.
        if np.vdot(matrix, matrix).real <= 1.0:
            return np.asarray(scipy.linalg.expm(matrix))
        norms = np.asarray(np.linalg.matrix_norm(matrix))
        norms = np.where(np.isfinite(norms), norms, 0.0)
        if (largest := norms.max(initial=0.0)) > MAX_EXPONENT:
            lengths = np.linalg.norm(v, axis=-1)
            longest = float(np.max(lengths, where=np.isfinite(lengths), initial=0.0))
            raise FlowOverflowError(
                f"the flow of v with |v| = {longest:.3g} can't be computed in double precision: "
                f"the matrix in its exponential has norm {largest:.3g}, more than "
                f"{MAX_EXPONENT:.3g}"
            )
        halvings = np.ceil(np.log2(np.maximum(norms, 1.0))).astype(int)
        result = np.asarray(scipy.linalg.expm(matrix * np.ldexp(1.0, -halvings)[..., None, None]))
        for squarings in range(int(halvings.max(initial=0))):
            unfinished = halvings > squarings
            result[unfinished] = result[unfinished] @ result[unfinished]
        return result


def combine(v: Array, basis: Points) -> Points:
    """Return the sum of ``v[..., i] * basis[i]``, shape ``(..., *basis.shape[1:])``."""
    flat = v @ basis.reshape(len(basis), -1)
    return np.asarray(flat.reshape(*v.shape[:-1], *basis.shape[1:]))


def newton_schulz(y: Points) -> Points:
    r"""Return :math:`\frac32 y - \frac12 y\, y^* y`, one step towards :math:`y^* y = I`.

    Products of rounded group elements leave the group: after 10^5 random flows on SO(3) the
    distance is 1e-13, and for 10^5 equal ones 1e-12, since then the rounding errors add up. The
    step is the identity on the group and reduces a distance :math:`\epsilon` to
    :math:`\frac32\epsilon^2`, so it removes rounding errors without changing the order of a method.
    It converges to the polar factor (Higham, *Functions of Matrices*, 2008, section 8.3). The
    arrays may be those of JAX.
    """
    nearer: Points = 1.5 * y - 0.5 * (y @ (y.mT.conj() @ y))
    return nearer


def symplectic_correction(y: Points, form: Array, xp: Any = np) -> Points:
    r"""Return the change :math:`\delta` of least norm that makes matrices preserve a skew form J.

    To first order :math:`\delta = J^T y \Lambda` with a skew :math:`\Lambda` for which
    :math:`y^T y \Lambda + \Lambda y^T y = J - y^T J y`. In the basis of the singular vectors of y
    this equation is diagonal. With ``xp=jax.numpy`` arrays are those of JAX.
    """
    left, singular, right = xp.linalg.svd(y)
    rows, columns = singular[..., :, None], singular[..., None, :]
    preserved = rows * (left.mT @ form @ left) * columns
    defect = preserved - right @ form @ right.mT
    positive = xp.maximum(singular, xp.finfo(y.dtype).eps * singular[..., :1])
    length = xp.hypot(positive[..., :, None], positive[..., None, :])
    change: Points = form.T @ left @ (-rows / length * (defect / length)) @ right
    return change


def singular_values(y: Points) -> Array:
    """Return the decreasing singular values of matrices, NaN where LAPACK may raise."""
    finite = np.asarray(np.isfinite(y).all(axis=(-2, -1)))[..., None]
    singular = np.linalg.svd(np.where(finite[..., None], y, 0.0), compute_uv=False)
    return np.where(finite, singular, np.nan)


def two_norm(y: Points) -> Array:
    """Return the 2-norms of matrices, shape ``(...)``, NaN where they aren't finite."""
    return singular_values(y)[..., 0]


def newton_corrected(y: Points, correction: Callable[[Points], Points]) -> Points:
    """Return points after Newton's method, iterated until the correction is rounding."""
    for _ in range(_MAX_CORRECTIONS):
        change = correction(y)
        y = y + change
        if not (np.abs(change).max(initial=0.0) > _MIN_CORRECTION * np.abs(y).max(initial=0.0)):
            break
    return y


def distance_from_unitary(y: Points, *, special: bool) -> Array:
    r"""Return the 2-norm distance to the nearest matrix with orthonormal columns.

    Matrices have the shape ``(..., n, k)`` with ``k <= n``; the distance is NaN for those that
    aren't finite. With ``special`` the nearest matrix must also have determinant 1 (``k == n``
    only): where the polar factor of a real matrix is a reflection, the sign of the least singular
    value is changed, so that a reflection has distance 2; the polar factor of a complex matrix,
    with determinant :math:`e^{i\theta}`, is multiplied by :math:`e^{-i\theta / n}`.
    """
    if not special:
        return np.asarray(np.abs(singular_values(y) - 1.0).max(axis=-1))
    finite = np.asarray(np.isfinite(y).all(axis=(-2, -1)))  # LAPACK may raise for other matrices
    left, singular, right = np.linalg.svd(np.where(finite[..., None, None], y, 0.0))
    determinant, nearest = np.linalg.det(left) * np.linalg.det(right), np.ones(())
    if np.iscomplexobj(y):
        nearest = np.exp(-1j * np.angle(determinant) / y.shape[-1])[..., None]
    else:
        singular[..., -1] *= np.where(determinant < 0.0, -1.0, 1.0)
    return np.where(finite, np.abs(singular - nearest).max(axis=-1), np.nan)


def nearest_unitary(y: Points, *, special: bool) -> Points:
    r"""Return the nearest matrices with orthonormal columns, those of the polar factor.

    The arguments are those of `distance_from_unitary`. Matrices are NaN where the nearest one is
    not unique up to rounding.
    """
    left, singular, right = np.linalg.svd(y, full_matrices=False)
    least = singular[..., -1]
    if special:
        determinant = np.linalg.det(left) * np.linalg.det(right)
        if np.iscomplexobj(y):
            left = left * np.exp(-1j * np.angle(determinant) / y.shape[-1])[..., None, None]
        else:
            least = singular[..., -2] + np.sign(determinant) * least
            left[..., -1] *= np.sign(determinant)[..., None]
    unique = least > y.shape[-2] * np.finfo(np.float64).eps * singular[..., 0]
    return np.where(unique[..., None, None], left @ right, np.nan)


def random_unitary(
    rng: np.random.Generator, shape: tuple[int, ...], *, complex_: bool = False
) -> Points:
    """Return matrices with orthonormal columns, uniform under the unitary (orthogonal) group.

    The QR factorisation of a normal matrix, made unique by a positive diagonal of R (Mezzadri,
    Notices Amer. Math. Soc. 54 (2007), 592-604).
    """
    normal = rng.standard_normal(shape)
    if complex_:
        normal = normal + 1j * rng.standard_normal(shape)
    q, r = np.linalg.qr(normal)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    return np.asarray(q * (diagonal / np.abs(diagonal))[..., None, :])


def eigh_where_finite(matrices: Points) -> tuple[Array, Points]:
    """Return eigenvalues and eigenvectors of symmetric matrices, NaN where not finite."""
    finite = np.asarray(np.isfinite(matrices).all(axis=(-2, -1), keepdims=True))
    values, vectors = np.linalg.eigh(np.where(finite, matrices, np.eye(matrices.shape[-1])))
    return np.where(finite[..., 0], values, np.nan), np.where(finite, vectors, np.nan)


# Largest 1-norm of X - I for the series: z below has norm 1/7, the omitted terms are 1e-18.
_NEAR_IDENTITY = 0.25
# Largest number of square roots; after more, repeated squaring would lose all digits.
_MAX_ROOTS = 60
_ARTANH = [1.0 / (2 * k + 1) for k in range(11)]


def _log1p(difference: Points, far: Callable[[Points], Points]) -> Points:
    r"""Return logarithms of :math:`I + d`; near the identity with the relative accuracy of d.

    With :math:`z = d\,(2 I + d)^{-1}` it is :math:`2(z + \tfrac13 z^3 + \tfrac15 z^5 + \dots)`
    (Higham, *Functions of Matrices*, 2008, section 11.3), summed near the identity; elsewhere
    ``far`` returns the logarithm of one matrix. Shapes are ``(..., n, n)``; NaN where an entry
    isn't finite.
    """
    identity = np.eye(difference.shape[-1])
    near = np.asarray(np.linalg.matrix_norm(difference, ord=1) <= _NEAR_IDENTITY)
    result = np.empty_like(difference)
    if near.any():
        result[near] = _series(difference[near])
    for index in map(tuple, np.argwhere(~near)):
        finite = np.isfinite(difference[index]).all()
        result[index] = far(identity + difference[index]) if finite else np.nan
    return result


def _series(small: Points) -> Points:
    """Return the logarithms of the identity plus matrices of norm at most `_NEAR_IDENTITY`."""
    identity = np.eye(small.shape[-1])
    z = np.linalg.solve(small + 2.0 * identity, small)
    square = z @ z
    series = _ARTANH[-1] * identity
    for coefficient in _ARTANH[-2::-1]:
        series = coefficient * identity + square @ series
    return np.asarray(2.0 * (z @ series))


def real_log1p(difference: Points) -> Points:
    """Return the principal logarithms of I + ``difference``, NaN where they are not real."""
    return _log1p(difference, _real_logarithm)


def _real_logarithm(x: Points) -> Points:
    """Return the logarithm of a matrix by inverse scaling and squaring of its Schur form."""
    undefined = np.full_like(x, np.nan)
    if np.linalg.cond(x) * np.finfo(np.float64).eps > 1.0:
        return undefined
    root, vectors = scipy.linalg.rsf2csf(*scipy.linalg.schur(x, output="real"))
    eigenvalues, identity = np.diagonal(root), np.eye(len(x))
    if ((eigenvalues.imag == 0.0) & (eigenvalues.real <= 0.0)).any():
        return undefined
    logarithms = np.log(eigenvalues)
    roots = 0
    while not np.linalg.matrix_norm(root - identity, ord=1) <= _NEAR_IDENTITY:
        if roots == _MAX_ROOTS or not np.isfinite(root).all():
            return undefined
        root = scipy.linalg.sqrtm(root)
        roots += 1
    logarithm = np.ldexp(1.0, roots) * _series(root - identity)
    np.fill_diagonal(logarithm, logarithms)
    return np.asarray((vectors @ logarithm @ vectors.conj().T).real)


def rotation_log1p(difference: Points) -> Points:
    r"""Return logarithms of rotations I + ``difference``, with angles of at most :math:`\pi`."""
    return _log1p(difference, _rotation_logarithm)


def _rotation_logarithm(x: Points) -> Points:
    # The real Schur form of a rotation is block diagonal: rotations of planes, ones, and an even
    # number of minus ones, each pair of which is a rotation of a plane by pi.
    form, axes = scipy.linalg.schur(x, output="real")
    n = len(form)
    logarithm = np.zeros_like(form)
    j = 0
    negative: list[int] = []
    while j < n:
        if j + 1 < n and form[j + 1, j] != 0.0:
            sine = 0.5 * (form[j + 1, j] - form[j, j + 1])
            cosine = 0.5 * (form[j, j] + form[j + 1, j + 1])
            angle = np.arctan2(sine, cosine)
            logarithm[j + 1, j], logarithm[j, j + 1] = angle, -angle
            j += 2
        else:
            if form[j, j] < 0.0:
                negative.append(j)
            j += 1
    for first, second in zip(negative[::2], negative[1::2], strict=False):
        logarithm[second, first], logarithm[first, second] = np.pi, -np.pi
    return np.asarray(axes @ logarithm @ axes.T)


def unitary_log1p(difference: Points, *, special: bool) -> Points:
    r"""Return logarithms of unitary I + ``difference``, skew-Hermitian up to rounding.

    They are traceless if ``special``, for determinants of 1. Otherwise the angles are in
    :math:`(-\pi, \pi]`.
    """
    far = partial(_unitary_logarithm, special=special)
    result = _log1p(difference, far)
    if special:
        # With 26 or more eigenvalues, small angles may add up to 2 pi.
        turns = np.trace(result, axis1=-2, axis2=-1).imag
        for index in map(tuple, np.argwhere(np.abs(turns) > np.pi)):
            result[index] = far(np.eye(difference.shape[-1]) + difference[index])
    return result


def _unitary_logarithm(x: Points, *, special: bool) -> Points:
    # The Schur form of a normal matrix is diagonal, with exactly orthonormal vectors.
    form, vectors = scipy.linalg.schur(x, output="complex")
    angles = np.angle(np.diagonal(form))
    if special:
        # They sum to 2 pi k; shift the k largest (or smallest) by 2 pi, so that they sum to zero.
        turns = round(float(angles.sum()) / (2.0 * np.pi))
        order = np.argsort(-np.sign(turns) * angles)
        angles[order[: abs(turns)]] -= np.sign(turns) * 2.0 * np.pi
    return np.asarray((vectors * (1j * angles)) @ vectors.conj().T)
