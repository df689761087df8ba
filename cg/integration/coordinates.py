"""Differences of points in the coordinates of a frame, and what to measure them by."""

from __future__ import annotations

import numpy as np

from cg.frames import Euclidean, Product, Semidirect
from cg.frames.base import Array, Frame, Points


def coordinate_sizes(frame: Frame, y: Points) -> Array:
    """Return the size that a change of each coordinate is to be compared with.

    A translation of Euclidean space is compared with the coordinate that it changes, one in a
    semidirect product with the length of the vector that it changes.  All other coordinates,
    such as angles, have no magnitude that depends on the point: their unit moves a point about
    as far as the manifold is large, and their size is one.

    Parameters
    ----------
    frame
        The frame.
    y
        Points, shape ``(..., *point_shape)``.

    Returns
    -------
    ndarray
        Shape ``(..., dim)``.
    """
    if isinstance(frame, Euclidean):
        return np.abs(y)
    if isinstance(frame, Product):
        parts = zip(frame.factors, frame.split(y), strict=True)
        return np.concatenate([coordinate_sizes(part, x) for part, x in parts], axis=-1)
    sizes = np.ones((*y.shape[: y.ndim - len(frame.point_shape)], frame.dim))
    if isinstance(frame, Semidirect):
        n = frame.group.size
        columns = np.linalg.norm(y[..., :n, n:], axis=-2)
        sizes[..., frame.group.dim :] = np.repeat(columns, n, axis=-1)
    return sizes
