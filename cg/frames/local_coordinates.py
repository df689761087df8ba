"""Coefficients of the flow between nearby points of any frame, by corrections."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cg.frames.arrays import Array, Points

if TYPE_CHECKING:
    from cg.frames.base import Frame

# Singular values of a matrix of fields below this fraction of the largest are rounding.
_RANK_TOLERANCE = 1e-12
# Corrections of nearby coordinates by fields shrink by a factor of about |v|, and where that is
# slow Newton's take over; points that these don't find are not nearby.
_MAX_CORRECTIONS = 20
_SLOW = 0.1
_FAR = 1e9
# Of the points: some twenty roundings
_REACHED = 5e-15
# Of the points; below it slowness is no reason to go on.
_ROUNDING = 1e-14
_DIFFERENCE = 1e-8
_DIFFERENCE_RANK_TOLERANCE = 1e-5
# Further off than this, of its size, no point is reached.
_MISSED = 1e-8


def local_coordinates(frame: Frame, guess: Array, start: Points, end: Points) -> Array:
    """Return coefficients whose flow leads from one point to another, near it.

    Parameters
    ----------
    frame
        The frame.
    guess
        Coefficients to begin with, where they are better than none; shape ``(count, dim)``.
    start, end
        Shape ``(count, *point_shape)``.

    Returns
    -------
    ndarray
        Shape ``(count, dim)``, NaN where the points aren't near enough.
    """
    v = np.nan_to_num(guess, posinf=0.0, neginf=0.0)
    y = start
    if v.any():
        y = frame.flow(v, start)
        # Of points that are large and close a logarithm may have no digits.
        lost = ~(_lengths(end - y) <= _lengths(end - start))
        if lost.any():
            v[lost] = 0.0
            y = np.where(lost.reshape(-1, *(1,) * (y.ndim - 1)), start, y)
    length, away = _lengths(end), _lengths(end - y)
    v[~np.isfinite(away)] = np.nan
    guessed = (v != 0.0).any(axis=-1)
    active = np.flatnonzero(away > np.where(guessed, _REACHED * length, 0.0))
    reached, left = y[active], away[active]
    exact = np.zeros(len(active), dtype=bool)
    for _ in range(_MAX_CORRECTIONS):
        if not len(active):
            break
        tried = frame._correct(v[active], start[active], reached, end[active], exact)
        # What is further than any point nearby can be stays where it is, and ends here.
        far = ~(np.linalg.norm(tried, axis=-1) < _FAR)
        tried[far] = v[active[far]]
        moved = frame.flow(tried, start[active])
        size = _lengths(end[active] - moved)
        better = size < 0.5 * left
        v[active[better]], reached[better] = tried[better], moved[better]
        # Fields at the end stand for the flow's derivative while that is enough.
        slow = ~(size < _SLOW * left) & (left > _ROUNDING * length[active])
        left[better] = away[active[better]] = size[better]
        go_on = better | (slow & ~exact)
        active, reached, left = active[go_on], reached[go_on], left[go_on]
        exact = (exact | slow)[go_on]
    v[away > _MISSED * length] = np.nan
    return v


def newton_correction(frame: Frame, v: Array, start: Points, y: Points, end: Points) -> Array:
    """Return coefficients corrected by the derivative of the flow, from differences.

    Parameters
    ----------
    frame
        The frame.
    v
        Shape ``(dim,)``.
    start, y, end
        Points before and after the flow, and where it is to lead, shape ``point_shape``.
    """
    step = _DIFFERENCE * max(1.0, float(np.linalg.norm(v)))
    slopes = (frame.flow(v + step * np.eye(frame.dim), start) - y) / step
    left = (end - y)[None]
    return np.asarray(v + shortest_coefficients(slopes[None], left, _DIFFERENCE_RANK_TOLERANCE)[0])


def _lengths(points: Points) -> Array:
    """Return the Euclidean norms of points, shape ``(count,)``."""
    return np.asarray(
        np.linalg.norm(points.reshape(len(points), math.prod(points.shape[1:])), axis=-1)
    )


def shortest_coefficients(
    fields: Points, tangent: Points, tolerance: float = _RANK_TOLERANCE
) -> Array:
    """Return the shortest coefficients of fields whose sum is nearest to a tangent.

    Parameters
    ----------
    fields
        Shape ``(count, dim, *point_shape)``.
    tangent
        Shape ``(count, *point_shape)``.
    tolerance
        Singular values below this fraction of the largest count as zero.
    """
    size = math.prod(fields.shape[2:])
    rows = np.ascontiguousarray(fields).reshape(*fields.shape[:2], size).view(np.float64)
    right = np.ascontiguousarray(tangent).reshape(len(tangent), size).view(np.float64)
    finite = np.asarray(np.isfinite(rows).all(axis=(1, 2)))[:, None]
    rows = np.where(finite[..., None], rows, 0.0)  # there may be no singular values otherwise
    inverse = np.linalg.pinv(rows.mT, rcond=tolerance)
    return np.where(finite, (inverse @ right[..., None])[..., 0], np.nan)
