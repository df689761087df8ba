"""Functions of stacked matrices that several frames share."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy

from cg.frames.arrays import Array, Points
from cg.frames.base import FlowOverflowError

# Coefficients of x^(4 i + j) / (4 i + j)!, shape (5, 4); the remainder for |x| = 1 is 4e-19.
_TAYLOR = np.array([1.0 / math.factorial(k) for k in range(20)]).reshape(5, 4)

# Up to this size of a matrix products of stacks are faster than SciPy's exponential.
_MAX_TAYLOR = 16

MAX_EXPONENT = 2.0**32
"""The largest norm of a matrix whose exponential is computed.

Whatever the algorithm, an exponential has an error of the matrix's norm times the rounding unit,
times a factor of up to 60 for those of the tests.  Restoring squares how far that is from the
manifold: at this norm to 5e-9, beyond it would soon be further than a point may be.
"""

# Of unitary exponentials: repeated squaring loses digits that eigenvalues don't.
_MAX_SQUARED = 1e3

# Newton's method from a point nearby doubles the digits each time.
_MAX_CORRECTIONS = 10
_ROUNDING = 1e-15


def expm(matrix: Points, v: Array) -> Points:
    """Return the exponentials of stacked square matrices; what overflows is not finite.

    Parameters
    ----------
    matrix
        Shape ``(..., n, n)``.
    v
        The coefficients whose matrices they are, for the message.

    Raises
    ------
    FlowOverflowError
        If a matrix is too large for its exponential to have any correct digits to speak of.
    """
    # One dot product settles it but for what is enormous, or not finite.
    if not np.vdot(matrix, matrix).real <= MAX_EXPONENT**2:
        norms = np.linalg.matrix_norm(matrix)
        largest = float(np.max(norms, where=np.isfinite(norms), initial=0.0))
        if largest > MAX_EXPONENT:
            lengths = np.linalg.norm(v, axis=-1)
            longest = float(np.max(lengths, where=np.isfinite(lengths), initial=0.0))
            raise FlowOverflowError(
                f"the flow of v with |v| = {longest:.3g} can't be computed in double precision: "
                f"the matrix in its exponential has norm {largest:.3g}, more than "
                f"{MAX_EXPONENT:.3g}"
            )
    return _expm(matrix)


def _scipy_expm(matrix: Points) -> Points:
    return np.asarray(scipy.linalg.expm(matrix))


def _expm(matrix: Points, small: Callable[[Points], Points] = _scipy_expm) -> Points:
    """Return exponentials, right to a few roundings times the norm of the matrices.

    Those of matrices of norm at most one are ``small``'s. SciPy's Padé approximant stays in a
    group such as the symplectic one, which matters where points grow.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        # Up to a norm of 1 SciPy's is. At 3 it has lost two digits and at 10 four, so that larger
        # matrices are halved until they are small, and their exponentials squared as often.
        if np.vdot(matrix, matrix).real <= 1.0:
            return small(matrix)
        norms = np.linalg.matrix_norm(matrix)
        known = np.where(np.isfinite(norms) & (norms > 1.0), norms, 1.0)
        halvings = np.ceil(np.log2(known)).astype(int)
        scaled = matrix * np.ldexp(1.0, -halvings)[..., None, None]
        result = small(scaled)
        for done in range(int(halvings.max(initial=0))):
            rest = halvings > done
            result[rest] = result[rest] @ result[rest]
        return result


def _taylor_expm(matrix: Points) -> Points:
    """Return exponentials of matrices of norm at most one, right to rounding."""
    n = matrix.shape[-1]
    if n > _MAX_TAYLOR:
        return _scipy_expm(matrix)
    # Taylor's polynomial of degree 19, in powers of the fourth power: SciPy goes from one matrix
    # to the next in Python, and solves equations for each.
    powers = np.empty((4, *matrix.shape), dtype=matrix.dtype)
    powers[0] = np.eye(n)
    powers[1] = matrix
    np.matmul(matrix, matrix, out=powers[2])
    np.matmul(powers[2], matrix, out=powers[3])
    fourth = powers[2] @ powers[2]
    parts = (_TAYLOR @ powers.reshape(4, -1)).reshape(5, *matrix.shape)
    result: Points = parts[4]
    for i in (3, 2, 1, 0):
        result = result @ fourth
        result += parts[i]
    return result


def unitary_exponential(matrix: Points, *, special: bool = False) -> Points:
    r"""Return the exponentials of stacked skew-Hermitian matrices of any size.

    Those of large ones are :math:`V e^{\Theta} V^*` with the orthonormal vectors of a Schur form,
    whose blocks are turned by angles that are reduced one by one: unitary to rounding, and where
    ``special`` of determinant 1.
    """
    if np.vdot(matrix, matrix).real <= _MAX_SQUARED**2:
        return _expm(matrix, _taylor_expm)
    norms = np.linalg.matrix_norm(matrix)
    large = np.isfinite(norms) & (norms > _MAX_SQUARED)
    result = _expm(np.where(large[..., None, None], 0.0, matrix), _taylor_expm)
    for index in map(tuple, np.argwhere(large)):
        omega = matrix[index]
        result[index] = _turned(omega, special) if np.iscomplexobj(omega) else _rotated(omega)
    return result


def _turned(omega: Points, special: bool) -> Points:
    """Return the exponential of one skew-Hermitian matrix."""
    angles, vectors = np.linalg.eigh(-1j * omega)
    phases = np.exp(1j * angles)
    if special:
        # The angles add up to zero no better than the largest of them is rounded.
        phases *= np.exp(-1j * np.angle(phases.prod()) / len(phases))
    return np.asarray((vectors * phases) @ vectors.conj().T)


def _rotated(omega: Points) -> Points:
    """Return the exponential of one skew matrix."""
    form, axes = scipy.linalg.schur(omega, output="real")
    rotation = np.eye(len(form))
    j = 0
    while j + 1 < len(form):
        angle = 0.5 * (form[j + 1, j] - form[j, j + 1])
        if form[j + 1, j] == 0.0:
            j += 1
            continue
        rotation[j : j + 2, j : j + 2] = [
            [np.cos(angle), -np.sin(angle)],
            [np.sin(angle), np.cos(angle)],
        ]
        j += 2
    return np.asarray(axes @ rotation @ axes.T)


def combine(v: Array, basis: Points) -> Points:
    """Return the sum of ``v[..., i] * basis[i]``, shape ``(..., *basis.shape[1:])``."""
    flat = v @ basis.reshape(len(basis), -1)
    return np.asarray(flat.reshape(*v.shape[:-1], *basis.shape[1:]))


def newton_schulz(y: Points, adjoint: Points) -> Points:
    r"""Return :math:`\frac32 y - \frac12 y\, y^* y`, one step towards :math:`y^* y = I`.

    Products of rounded group elements leave the group: after 10^5 random flows on SO(3) the
    distance is 1e-13, and for 10^5 equal ones 1e-12, since then the rounding errors add up.  The
    step is the identity on the group and takes a distance :math:`\epsilon` to
    :math:`\frac32\epsilon^2`, so it removes rounding only and leaves the order of a method
    alone.  With the conjugate transpose as ``adjoint`` it leads to the polar factor, section 8.3
    of [1]_.

    References
    ----------
    .. [1] N. J. Higham, *Functions of Matrices*, SIAM, 2008.
    """
    return np.asarray(1.5 * y - 0.5 * (y @ (adjoint @ y)))


def determinant_step(y: Points) -> Points:
    """Return ``y`` after a Newton step, along its multiples, towards determinant 1."""
    with np.errstate(invalid="ignore"):
        excess = np.linalg.det(y) - 1.0
    return np.asarray(y * (1.0 - excess / y.shape[-1])[..., None, None])


def determinant_correction(y: Points) -> Points:
    r"""Return the shortest change that takes the determinants of real matrices to 1.

    To first order it is a multiple of the gradient, the matrix of cofactors.  From the singular
    values :math:`s_i` and vectors it comes without cancellation, and without the products of
    singular values, which would overflow.
    """
    left, singular, right = np.linalg.svd(y)
    # Where rounding decides upon the sign the change is no longer than that rounding.
    sign = np.where(np.linalg.det(y) < 0.0, -1.0, 1.0)
    smallest = singular[..., -1:]
    # What is below rounding is not known, and is not to be divided by.
    others = np.maximum(singular, _rounding(singular))
    # The cofactors are products of all singular values but one: here in units of the largest.
    cofactors = smallest / others
    cofactors[..., -1] = 1.0
    excess = smallest - sign[..., None] / others[..., :-1].prod(axis=-1, keepdims=True)
    change = (-excess / np.vecdot(cofactors, cofactors)[..., None]) * cofactors
    return np.asarray((left * change[..., None, :]) @ right)


def _rounding(singular: Array) -> Array:
    """Return how far singular values may be off, shape ``(..., 1)``."""
    return np.asarray(np.finfo(np.float64).eps * singular[..., :1])


def symplectic_correction(y: Points, form: Array) -> Points:
    r"""Return the shortest change :math:`\delta` that makes matrices preserve a skew form J.

    To first order :math:`\delta = J^T y \Lambda` with a skew :math:`\Lambda` for which
    :math:`y^T y \Lambda + \Lambda y^T y = J - y^T J y`.  The singular vectors of y turn this
    into quotients of single entries.
    """
    left, singular, right = np.linalg.svd(y)
    rows, columns = singular[..., :, None], singular[..., None, :]
    kept = rows * (left.mT @ form @ left) * columns
    defect = kept - right @ form @ right.mT
    known = np.maximum(singular, _rounding(singular))
    length = np.hypot(known[..., :, None], known[..., None, :])
    return np.asarray(form.T @ left @ (-rows / length * (defect / length)) @ right)


def shortest_step(y: Points, correction: Callable[[Points], Points]) -> Points:
    r"""Return matrices after one Newton step, the shortest, towards a group that isn't compact.

    On such a group the solutions may grow, and how a step is measured matters.  A matrix of size
    :math:`g` is known up to :math:`\epsilon g`, and what must vanish on the group, such as
    :math:`\det y - 1`, only up to :math:`\epsilon g` times its derivative.  The shortest step
    divides by that derivative: it is :math:`\epsilon g` long, rounding like that of the flow
    itself, and leaves a large solution its digits.  A step within the group's geometry, that to
    a multiple of y or that of `newton_schulz` with the group's own involution, is y times a
    matrix of size :math:`\epsilon g^2`: at :math:`g = 10^8` it leaves no digit.
    """
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        try:
            restored = y + correction(y)
            if np.isfinite(restored.sum()):
                return np.asarray(restored)
        except np.linalg.LinAlgError:  # some matrix isn't finite
            pass
        finite = np.isfinite(y).all(axis=(-2, -1), keepdims=True)
        restored = y + correction(np.where(finite, y, np.eye(y.shape[-1])))
    known = np.isfinite(restored).all(axis=(-2, -1), keepdims=True)
    return np.where(finite & known, restored, y)


def relative_length(y: Points, correction: Callable[[Points], Points]) -> Array:
    """Return the 2-norms of corrections relative to those of the points, shape ``(...)``."""
    finite = np.isfinite(y).all(axis=(-2, -1), keepdims=True)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        change = np.where(finite, correction(np.where(finite, y, np.eye(y.shape[-1]))), np.nan)
        return np.asarray(two_norm(change) / two_norm(y))


def singular_values(y: Points) -> Array:
    """Return singular values, the largest first, of matrices; NaN of those that aren't finite.

    LAPACK may find none of the latter, and then ends in an error, or not, as it was compiled.
    """
    finite = np.asarray(np.isfinite(y).all(axis=(-2, -1)))[..., None]
    found = np.linalg.svd(np.where(finite[..., None], y, 0.0), compute_uv=False)
    return np.where(finite, found, np.nan)


def two_norm(y: Points) -> Array:
    """Return the 2-norms of matrices, shape ``(...)``, NaN of those that aren't finite."""
    return singular_values(y)[..., 0]


def corrected(y: Points, correction: Callable[[Points], Points]) -> Points:
    """Return points after corrections by Newton's method, until nothing but rounding is left."""
    for _ in range(_MAX_CORRECTIONS):
        change = correction(y)
        y = y + change
        if not (np.abs(change).max(initial=0.0) > _ROUNDING * np.abs(y).max(initial=0.0)):
            break
    return y


def unit_step(y: Points) -> Points:
    r"""Return :math:`\frac12 (3 - |y|^2)\, y`, the same step for vectors of length one."""
    return np.asarray((1.5 - 0.5 * np.vecdot(y, y))[..., None] * y)


def distance_from_unitary(y: Points, *, special: bool) -> Array:
    r"""Return the 2-norm distance to the nearest matrix with orthonormal columns.

    It is NaN of matrices that aren't finite.

    Parameters
    ----------
    y
        Real or complex matrices, shape ``(..., n, k)`` with ``k <= n``.
    special
        Whether the nearest matrix must also have determinant 1 (``k == n`` only).  Where the
        polar factor of a real matrix is a reflection, the direction of the smallest singular
        value is turned round, so that a reflection is at distance 2; the polar factor of a
        complex matrix, with determinant :math:`e^{i\theta}`, is turned by :math:`-\theta / n`.
    """
    finite = np.asarray(np.isfinite(y).all(axis=(-2, -1)))
    if not finite.all():  # for which there may be no singular values
        error = distance_from_unitary(np.where(finite[..., None, None], y, 0.0), special=special)
        return np.where(finite, error, np.nan)
    if not special:
        singular = np.linalg.svd(y, compute_uv=False)
        return np.asarray(np.abs(singular - 1.0).max(axis=-1))
    left, singular, right = np.linalg.svd(y)
    determinant = np.linalg.det(left) * np.linalg.det(right)
    if np.iscomplexobj(y):
        phase = np.exp(-1j * np.angle(determinant) / y.shape[-1])
        return np.asarray(np.abs(singular - phase[..., None]).max(axis=-1))
    singular[..., -1] = np.where(determinant < 0.0, -singular[..., -1], singular[..., -1])
    return np.asarray(np.abs(singular - 1.0).max(axis=-1))


def nearest_unitary(y: Points, *, special: bool) -> Points:
    r"""Return the nearest matrices with orthonormal columns, those of the polar factor.

    Parameters
    ----------
    y
        Real or complex matrices, shape ``(..., n, k)`` with ``k <= n``.
    special
        Whether they must also have determinant 1, as for `distance_from_unitary`.

    Returns
    -------
    ndarray
        NaN where rounding decides which matrix is the nearest.
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

    The QR factorisation of a normal matrix, made unique by a positive diagonal of R [1]_.

    References
    ----------
    .. [1] F. Mezzadri, "How to generate random matrices from the classical compact groups",
       Notices Amer. Math. Soc. 54 (2007), 592-604.
    """
    normal = rng.standard_normal(shape)
    if complex_:
        normal = normal + 1j * rng.standard_normal(shape)
    q, r = np.linalg.qr(normal)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    return np.asarray(q * (diagonal / np.abs(diagonal))[..., None, :])


def eigh_where_finite(matrices: Points) -> tuple[Array, Points]:
    """Return eigenvalues, increasing, and eigenvectors of symmetric matrices; NaN if not finite.

    Parameters
    ----------
    matrices
        Shape ``(..., n, n)``.
    """
    finite = np.asarray(np.isfinite(matrices).all(axis=(-2, -1)))
    safe = np.where(finite[..., None, None], matrices, np.eye(matrices.shape[-1]))
    values, vectors = np.linalg.eigh(safe)
    return (
        np.where(finite[..., None], values, np.nan),
        np.where(finite[..., None, None], vectors, np.nan),
    )
