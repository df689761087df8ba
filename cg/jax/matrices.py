"""Exponentials and logarithms of matrices.

Near the identity a logarithm is the series of artanh. Farther away, the logarithm of a unitary
matrix is made of its eigenvalues. They are computed as eigenvalues of a Hermitian matrix, Cayley's
transform, since JAX has no Schur form on accelerators. The logarithm of any other matrix is the
series after repeated square roots.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cg.frames import SO, SU, MatrixGroup, U
from cg.frames.matrix_functions import MAX_EXPONENT
from cg.jax.rules import JaxArray, adjoint, linear, real_dtype

_MAX_SQUARINGS = round(math.log2(MAX_EXPONENT))
_NEAR_IDENTITY = 0.25
_ARTANH_TERMS = 12
_MAX_ROOTS = 60  # largest number of square roots that are taken one after the other
_ROOT_STEPS, _SIGN_STEPS = 60, 12  # Newton steps for a square root, and for a sign function
# Coefficients of x^(4 i + j) / (4 i + j)!, shape (5, 4); the remainder for |x| = 1 is 4e-19
_TAYLOR = np.array([1.0 / math.factorial(k) for k in range(20)]).reshape(5, 4)


def expm(matrix: JaxArray) -> JaxArray:
    """Return the exponential, NaN where the norm is greater than `MAX_EXPONENT`.

    It is a Taylor polynomial of a matrix of norm at most one, squared; the error is a few roundings
    times the norm. ``jax.scipy.linalg.expm`` uses its Padé approximant up to norm 11, where that
    loses eight digits.
    """
    dtype, n = real_dtype(matrix), len(matrix)
    norm = jnp.sqrt((jnp.abs(jax.lax.stop_gradient(matrix)) ** 2).sum())
    halvings = jnp.maximum(jnp.frexp(jnp.where(jnp.isfinite(norm), norm, 0.0))[1], 0)
    scaled = matrix * jnp.ldexp(jnp.ones((), dtype), -halvings)
    square = scaled @ scaled
    powers = jnp.eye(n, dtype=matrix.dtype), scaled, square, square @ scaled
    cubics = [sum(float(c) * x for c, x in zip(row, powers, strict=True)) for row in _TAYLOR]
    result, fourth = cubics[4], square @ square
    for cubic in cubics[3::-1]:
        result = result @ fourth + cubic

    def step(x: JaxArray, k: Any) -> tuple[JaxArray, None]:
        return jax.lax.cond(k < halvings, lambda: x @ x, lambda: x), None

    def squared() -> JaxArray:
        return jax.lax.scan(step, result, jnp.arange(_MAX_SQUARINGS))[0]

    result = jax.lax.cond(halvings > 0, squared, lambda: result)
    return jnp.where(halvings > _MAX_SQUARINGS, jnp.nan, result)


def projection(frame: MatrixGroup, matrix: JaxArray) -> JaxArray:
    """Return the coefficients of the orthogonal projection of a matrix onto the algebra."""
    dual = frame._dual.conj().T
    dtype = matrix.dtype if dual.dtype.kind == "f" else jnp.result_type(matrix, np.complex64)
    return (matrix.reshape(-1) @ jnp.asarray(dual, dtype)).real


def logarithm_of(
    frame: MatrixGroup, inverse: Callable[[JaxArray], JaxArray]
) -> Callable[[JaxArray], JaxArray]:
    r"""Return the logarithm of the identity plus a matrix, as coefficients.

    Near the identity it is a series in the matrix itself, which keeps its digits. The derivative
    is not that of the algorithm: from :math:`x' = x\, \Omega(w)` follows :math:`w = \varphi(-
    \operatorname{ad}_v)\, v'` with :math:`\varphi(z) = (e^z - 1) / z`, which is solved for v'.
    """
    far = _far_logarithm(frame)

    @jax.custom_jvp
    def log1p(difference: JaxArray) -> JaxArray:
        near = (jnp.abs(difference) ** 2).sum() < _NEAR_IDENTITY**2
        whole = jnp.eye(len(difference), dtype=difference.dtype) + difference
        matrix = jax.lax.cond(near, lambda: _series(difference), lambda: far(whole))
        return projection(frame, matrix)

    @log1p.defjvp
    def _log1p_jvp(primals: Any, tangents: Any) -> Any:
        (difference,), (change,) = primals, tangents
        v = log1p(difference)
        whole = jnp.eye(len(difference), dtype=difference.dtype) + difference
        rate = projection(frame, inverse(whole) @ change)
        # Row vectors times this matrix are brackets of minus v.
        bracket = -frame._side * linear(v, frame._adjoint_basis)
        zero, eye = jnp.zeros_like(bracket), jnp.eye(frame.dim, dtype=v.dtype)
        factor = expm(jnp.block([[bracket, eye], [zero, zero]]))[: frame.dim, frame.dim :]
        return v, jnp.linalg.solve(factor.T, rate)

    logarithm: Callable[[JaxArray], JaxArray] = log1p
    return logarithm


def _series(small: JaxArray) -> JaxArray:
    """Return the logarithm of the identity plus a small matrix."""
    eye = jnp.eye(len(small), dtype=small.dtype)
    z = jnp.linalg.solve(small + 2.0 * eye, small)
    square = z @ z
    total = eye / (2 * _ARTANH_TERMS + 1)
    for j in range(_ARTANH_TERMS - 1, -1, -1):
        total = eye / (2 * j + 1) + square @ total
    return 2.0 * (z @ total)


def _far_logarithm(frame: MatrixGroup) -> Callable[[JaxArray], JaxArray]:
    if isinstance(frame, SO):
        return _rotation_logarithm
    if isinstance(frame, SU | U):
        special = isinstance(frame, SU)
        return lambda x: _unitary_logarithm(x, special)
    return _general_logarithm


def _cayley_angles(x: JaxArray) -> tuple[JaxArray, JaxArray]:
    """Return the arguments of eigenvalues of a unitary matrix, none near -1, and eigenvectors.

    The eigenvalues of the Hermitian matrix i (1 - x) / (1 + x) are tangents of half the angles.
    """
    eye = jnp.eye(len(x), dtype=x.dtype)
    hermitian = 1j * jnp.linalg.solve(eye + x, eye - x)
    tangents, vectors = jnp.linalg.eigh(hermitian)
    return 2.0 * jnp.arctan(tangents), vectors


def _spectral(angles: JaxArray, vectors: JaxArray) -> JaxArray:
    return (vectors * (1j * angles)) @ adjoint(vectors)


def _unitary_logarithm(x: JaxArray, special: bool) -> JaxArray:
    """Return the logarithm of a unitary matrix with angles in (-π, π], or traceless if special."""
    turn = 2.0 * math.pi
    # No eigenvalue is near the middle of the largest gap between all of them and their conjugates.
    cosines = jnp.linalg.eigvalsh(0.5 * (x + adjoint(x)))
    bounds = jnp.arccos(jnp.clip(cosines, -1.0, 1.0))
    ends = jnp.sort(jnp.concatenate([-bounds, bounds]))
    gaps = jnp.append(ends[1:], ends[0] + turn) - ends
    widest = jnp.argmax(gaps)
    opposite = ends[widest] + 0.5 * gaps[widest] - 0.5 * turn
    angles, vectors = _cayley_angles(jnp.exp(-1j * opposite) * x)
    angles = angles + opposite
    rounding = 8.0 * len(x) * jnp.finfo(angles.dtype).eps
    angles = angles - turn * jnp.ceil((angles - rounding) / turn - 0.5)
    if special:
        # The sum is a multiple of a turn; shifts of the largest or smallest angles make it zero.
        turns = jnp.round(angles.sum() / turn)
        sign = jnp.sign(turns)
        rank = jnp.argsort(jnp.argsort(-sign * angles))
        angles = angles - jnp.where(rank < jnp.abs(turns), sign * turn, 0.0)
    return _spectral(angles, vectors)


def _rotation_logarithm(x: JaxArray) -> JaxArray:
    """Return the logarithm of a rotation, with angles of at most π.

    Planes whose angles are beyond the largest gap between cosines are turned by π, so that no
    eigenvalue is near -1. Their logarithm is that of the turned matrix plus π J, where J is the
    skew matrix with square -1 that belongs to the skew part of x: its sign function.
    """
    n = len(x)
    cosines, axes = jnp.linalg.eigh(0.5 * (x + x.T))
    lower = jnp.concatenate([-jnp.ones(1, x.dtype), cosines[1::2]])
    upper = jnp.append(cosines[::2], 1.0)[: len(lower)]
    beyond = jnp.arange(n) < 2 * jnp.argmax(upper - lower)
    inside = beyond[:, None] & beyond
    matrix = axes.T @ x @ axes
    # At an angle of π both directions are right, and the skew part is zero.
    either = jnp.kron(jnp.eye((n + 1) // 2), jnp.array([[0.0, -1.0], [1.0, 0.0]]))[:n, :n]
    least = 1e-3 * jnp.finfo(x.dtype).eps
    skew = jnp.where(inside, 0.5 * (matrix - matrix.T) + least * either, 0.0).astype(x.dtype)

    def improve(skew: JaxArray, _: Any) -> tuple[JaxArray, None]:
        """Take a step of Newton's method for a skew matrix whose square is minus the identity."""
        inverse = jnp.where(inside, jnp.linalg.inv(skew + jnp.diag(1.0 - beyond)), 0.0)
        inverse = 0.5 * (inverse - inverse.T)
        # a quotient of squares would overflow in single precision where angles are π
        norm, norm_of_inverse = jnp.sqrt((skew**2).sum()), jnp.sqrt((inverse**2).sum())
        scale = jnp.where(beyond.any(), norm_of_inverse / jnp.where(beyond.any(), norm, 1), 1)
        scale = jnp.sqrt(scale)
        return (0.5 * (scale * skew - inverse / scale)).astype(x.dtype), None

    half, _ = jax.lax.scan(improve, skew, None, length=_SIGN_STEPS)
    turned = x - 2.0 * (x @ (axes * beyond) @ axes.T)
    logarithm = _spectral(*_cayley_angles(turned)).real
    return logarithm + math.pi * (axes @ half @ axes.T)


def _general_logarithm(x: JaxArray) -> JaxArray:
    """Return the principal logarithm by square roots until the series is right; NaN without one."""
    eye = jnp.eye(len(x), dtype=x.dtype)

    def far(state: Any) -> JaxArray:
        root, count = state
        return (((root - eye) ** 2).sum() > _NEAR_IDENTITY**2) & (count < _MAX_ROOTS)

    root, count = jax.lax.while_loop(far, lambda state: (_root(state[0]), state[1] + 1), (x, 0))
    return jnp.ldexp(jnp.ones((), x.dtype), count) * _series(root - eye)


def _root(x: JaxArray) -> JaxArray:
    """Return the principal square root by the scaled iteration of Denman and Beavers, or NaN."""
    n = len(x)
    small = 1e-2 * math.sqrt(jnp.finfo(x.dtype).eps)  # its square is below rounding

    def unfinished(state: Any) -> JaxArray:
        _, _, change, count = state
        return (change > small) & (count < _ROOT_STEPS)

    def step(state: Any) -> Any:
        y, z, _, count = state
        logarithms = jnp.linalg.slogdet(y)[1] + jnp.linalg.slogdet(z)[1]
        scale = jnp.exp(-logarithms / (2 * n))
        next_y = 0.5 * (scale * y + jnp.linalg.inv(z) / scale)
        next_z = 0.5 * (scale * z + jnp.linalg.inv(y) / scale)
        change = jnp.sqrt(((next_y - y) ** 2).sum() / (next_y**2).sum())
        return next_y, next_z, change, count + 1

    start = x, jnp.eye(n, dtype=x.dtype), jnp.full((), jnp.inf, x.dtype), 0
    root, _, change, _ = jax.lax.while_loop(unfinished, step, start)
    return jnp.where(change <= small, root, jnp.nan)
