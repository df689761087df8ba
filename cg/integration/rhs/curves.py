"""Curves through samples: polynomials between them, and where these jump."""

from __future__ import annotations

import numpy as np

from cg.support.arrays import Array

_ROUNDING = 4 * float(np.finfo(float).eps)  # relative error of times and values


def curve_of(times: Array, values: Array, kind: str, causal: bool) -> tuple[Array, Array]:
    """Return the starts of the pieces of a curve and their polynomials, shape (powers, pieces, …).

    The first power is the zeroth, and times count from the start of the piece.
    """
    if kind == "hold":
        return times, values[None]
    from scipy.interpolate import CubicSpline

    steps = np.diff(times).reshape(-1, *[1] * (values.ndim - 1))
    if kind == "linear":
        return times[:-1], np.stack([values[:-1], np.diff(values, axis=0) / steps])
    if kind == "cubic":
        return times[:-1], np.ascontiguousarray(CubicSpline(times, values).c[::-1])
    if causal:
        slopes = np.zeros_like(values)
        slopes[1:] = np.diff(values, axis=0) / (0.5 * (steps[1:] + steps[:-1]))
        return times[:-1], np.stack([values - 0.5 * steps * slopes, slopes])
    mean = values.mean(axis=0)  # sums of what differs from it are smaller
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(steps * (values - mean), axis=0)])
    pieces = np.ascontiguousarray(CubicSpline(times, sums).derivative().c[::-1])
    pieces[0] += mean
    return times[:-1], pieces


def jumps_of_lines(times: Array, values: Array, slopes: Array, causal: bool) -> Array:
    """Return whether lines or their slopes jump at inner edges by more than rounding.

    Only those of causal averages don't begin where the one before ends.
    """
    length = np.diff(times)[:, None]
    sizes = np.abs(values) + np.abs(slopes) * np.maximum(length, np.abs(times[1:, None]))
    rounding = _ROUNDING * np.maximum(sizes[1:], sizes[:-1])
    bends = np.abs(np.diff(slopes, axis=0)) * np.minimum(length[1:], length[:-1])
    ends = values[:-1] + slopes[:-1] * length[:-1] if causal else values[1:]
    jumps: Array = (bends > rounding) | (np.abs(values[1:] - ends) > rounding)
    return jumps
