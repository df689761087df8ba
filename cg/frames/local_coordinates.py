"""Local coordinates on any frame, by a Gauss-Newton iteration."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cg.support.arrays import Array, Points

Flow = Callable[[Array, Points], Points]
# Coefficients after one step of the iteration, from those before, the start, the point that they
# reach, the end, and where the derivative of the flow is used
Correction = Callable[[Array, Points, Points, Points, Array], Array]

# Singular values of a matrix of fields below this fraction of the largest count as zero.
_RANK_TOLERANCE = 1e-12
# Corrections by the fields shrink by a factor of about |v|. Where that is slow, Newton's method
# with the derivative of the flow takes over. Where it fails too, corrections lead to a point on the
# way to the end, by halves; where the nearest doesn't help, the points are too far apart.
_MAX_CORRECTIONS = 40
_SLOW = 0.1
_LEAST_PART = 1 / 64  # of the way
_FAR = 1e9  # largest norm of coefficients
# Relative residuals: convergence (some twenty roundings), and the level below which a slow
# iteration stops.
_REACHED = 5e-15
_ROUNDING = 1e-14
_DIFFERENCE = 1e-8
_DIFFERENCE_RANK_TOLERANCE = 1e-5
_MISSED = 1e-8  # largest relative residual of an accepted result


def local_coordinates(
    flow: Flow, correct: Correction, guess: Array, start: Points, end: Points
) -> Array:
    """Return coefficients whose flow takes points to others near them, NaN where that fails.

    Points have the shape ``(count, *point_shape)``, coefficients ``(count, dim)``. The guess is
    replaced by zero where zero has a smaller residual.
    """
    v = np.nan_to_num(guess, posinf=0.0, neginf=0.0)
    y = start
    if v.any():
        y = flow(v, start)
        # The logarithm of points that are large and close may have no correct digits.
        lost = ~(_norms(end - y) <= _norms(end - start))
        if lost.any():
            v[lost] = 0.0
            y = np.where(lost.reshape(-1, *(1,) * (y.ndim - 1)), start, y)
    length, distance = _norms(end), _norms(end - y)
    v[~np.isfinite(distance)] = np.nan
    guessed = (v != 0.0).any(axis=-1)
    active = np.flatnonzero(distance > np.where(guessed, _REACHED * length, 0.0))
    reached, residual = y[active], distance[active]
    exact, part = np.zeros(len(active), dtype=bool), np.ones(len(active))
    for _ in range(_MAX_CORRECTIONS):
        if not len(active):
            break
        lead = part.reshape(-1, *(1,) * (y.ndim - 1))
        target = np.where(lead < 1.0, reached + lead * (end[active] - reached), end[active])
        tried = correct(v[active], start[active], reached, target, exact)
        # Coefficients that diverge are reset; their residual doesn't decrease.
        far = ~(np.linalg.norm(tried, axis=-1) < _FAR)
        tried[far] = v[active[far]]
        moved = flow(tried, start[active])
        size = _norms(end[active] - moved)
        rough = residual > _ROUNDING * length[active]
        better = size < np.where(rough, 1.0 - _SLOW * part, 0.5) * residual
        v[active[better]], reached[better] = tried[better], moved[better]
        # Switch to the derivative of the flow where the fields at the end converge slowly.
        slow = ~(size < _SLOW * residual) & rough
        residual[better] = distance[active[better]] = size[better]
        part = np.where(better, np.minimum(2.0 * part, 1.0), np.where(exact, 0.5 * part, part))
        unfinished = better | (slow & (part >= _LEAST_PART))
        active, reached, residual = active[unfinished], reached[unfinished], residual[unfinished]
        exact, part = (exact | slow)[unfinished], part[unfinished]
    v[distance > _MISSED * length] = np.nan
    return v


def nearest_coordinates(
    flow: Flow, coefficients: Callable[[Points, Points], Array], start: Points, end: Points
) -> Array:
    """Return the coefficients of the tangents nearest to the differences of points.

    They are zero where their flow doesn't lead nearer to the end.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # of points far apart
        v = np.nan_to_num(coefficients(start, end - start), posinf=0.0, neginf=0.0)
        v[~(np.linalg.norm(v, axis=-1) < _FAR)] = 0.0
        v[~(_norms(end - flow(v, start)) < _norms(end - start))] = 0.0
    return v


def newton_correction(flow: Flow, v: Array, start: Points, y: Points, end: Points) -> Array:
    """Return coefficients after a Newton step with finite differences of the flow.

    The flow of ``v``, shape ``(dim,)``, takes ``start`` to ``y``, and is to take it to ``end``.
    """
    step = _DIFFERENCE * max(1.0, float(np.linalg.norm(v)))
    slopes = (flow(v + step * np.eye(len(v)), start) - y) / step
    residual = (end - y)[None]
    return np.asarray(
        v + minimum_norm_coefficients(slopes[None], residual, _DIFFERENCE_RANK_TOLERANCE)[0]
    )


def _norms(points: Points) -> Array:
    """Return the Euclidean norms of points, shape ``(count,)``."""
    return np.asarray(
        np.linalg.norm(points.reshape(len(points), math.prod(points.shape[1:])), axis=-1)
    )


def minimum_norm_coefficients(
    fields: Points, tangent: Points, tolerance: float = _RANK_TOLERANCE
) -> Array:
    """Return the least-squares coefficients of minimum norm of tangents in given fields.

    Fields have the shape ``(count, dim, *point_shape)``, tangents ``(count, *point_shape)``.
    Singular values below ``tolerance`` times the largest one count as zero.
    """
    size = math.prod(fields.shape[2:])
    rows = np.ascontiguousarray(fields).reshape(*fields.shape[:2], size).view(np.float64)
    right = np.ascontiguousarray(tangent).reshape(len(tangent), size).view(np.float64)
    finite = np.asarray(np.isfinite(rows).all(axis=(1, 2)))[:, None]
    rows = np.where(finite[..., None], rows, 0.0)  # the SVD fails for non-finite entries
    inverse = np.linalg.pinv(rows.mT, rcond=tolerance)
    return np.where(finite, (inverse @ right[..., None])[..., 0], np.nan)
