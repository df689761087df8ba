"""Logarithms of stacked matrices, accurate near the identity."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy

from cg.support.arrays import Points

# Largest 1-norm of X - I for the series: z below has norm 1/7, the omitted terms are 1e-18.
_NEAR = 0.25
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
    near = np.asarray(np.linalg.matrix_norm(difference, ord=1) <= _NEAR)
    result = np.empty_like(difference)
    if near.any():
        result[near] = _series(difference[near])
    for index in map(tuple, np.argwhere(~near)):
        finite = np.isfinite(difference[index]).all()
        result[index] = far(identity + difference[index]) if finite else np.nan
    return result


def _series(small: Points) -> Points:
    """Return the logarithms of the identity plus matrices of norm at most `_NEAR`."""
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
    while not np.linalg.matrix_norm(root - identity, ord=1) <= _NEAR:
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
