"""How long steps may be over a curve through samples, so that none passes over what it does.

An error estimate sees a curve at the few nodes of a step only. Steps that have grown while nothing
happens, or while all is smooth, would pass over a pulse between two nodes, and accept it. The
samples are known before the first step, and so is how long steps may be where: the pieces of a
curve are put together in blocks of 2, 4, 8, …, as long as what is within a block is smooth on its
scale, and a step is no longer than the blocks that it touches.

At each level, each second of the points is predicted by the cubic through four of the others. For a
smooth curve the error of this falls by 16 from a level to the next finer one; what is shorter than
a block, such as a pulse or noise, has errors at fine levels that are larger than that.

All errors are compared to the variation of their own column: to the largest mean deviation from the
mean in a block around them, of any size. So neither units, nor other columns, nor what happens
long before or after matters. Deviations that are smaller by ``_IGNORED`` times the tolerance are
passed over: the integral of all of these is within the tolerance of that of the variation.
"""

from __future__ import annotations

import numpy as np

from cg.support.arrays import Array

_IGNORED = 0.08  # deviations between samples, of a spline whose kinks count as 1
_BLOCKS = 2.0  # in a step, whose nodes are closer than its ends
_PEAK = 1.5  # the largest value of an oscillation relative to its mean deviation
_FALL = 16.0  # ratio of the errors of cubics when distances are halved


class Resolution:
    """The variation of a curve on all scales; ``values`` has shape (points, columns)."""

    def __init__(self, times: Array, values: Array, rounding: Array) -> None:
        self._pieces = len(times) - 1
        self._times, values = _padded(times, values)
        self._scales = _scales(self._times, values)
        self._errors = [
            _prediction_errors(self._times[::step], values[::step], rounding)
            for step in 2 ** np.arange(len(self._scales) - 1)
        ]

    def kinks(self, sizes: Array) -> Array:
        """Return the largest of sizes at inner points, shape (points - 2, columns), relative."""
        scale = self._scales[0][: self._pieces]
        scale = np.maximum(scale[1:], scale[:-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(sizes > 0.0, sizes / scale, 0.0)
        return np.asarray(relative.max(axis=1))

    def longest_steps(self, tolerance: float) -> Array:
        """Return rows of times and how long steps may be from there on, up to the next time."""
        allowed = tolerance**0.25
        pieces = len(self._times) - 1
        level = np.zeros(pieces, dtype=np.int8)
        errors = np.zeros_like(self._scales[0])
        for k, (scale, own) in enumerate(zip(self._scales[1:], self._errors, strict=True), 1):
            seen = np.where(own > _IGNORED * tolerance * scale, own, 0.0)
            errors = np.maximum(_FALL * np.maximum(errors[::2], errors[1::2]), seen)
            smooth = (errors <= allowed * scale).all(axis=1)
            if not smooth.any():
                break
            level.reshape(-1, 2**k)[smooth] = k
        first = np.arange(self._pieces)
        sizes = 2 ** level[: self._pieces].astype(np.int64)
        first = first[first % sizes == 0]
        starts = self._times[first]
        return np.stack([starts, _BLOCKS * (self._times[first + sizes[first]] - starts)], axis=1)


def _padded(times: Array, values: Array) -> tuple[Array, Array]:
    """Return points continued to a power of two of pieces, by reflection at the last one."""
    pieces = len(times) - 1
    more = (1 << (pieces - 1).bit_length()) - pieces
    if not more:
        return times, values
    back = slice(-2, -2 - more, -1)
    return (
        np.concatenate([times, 2.0 * times[-1] - times[back]]),
        np.concatenate([values, 2.0 * values[-1] - values[back]]),
    )


def _scales(times: Array, values: Array) -> list[Array]:
    """Return of each block of 1, 2, 4, … pieces the largest variation in a block around it."""
    length = np.diff(times)[:, None]
    mean = 0.5 * (values[1:] + values[:-1])
    scales = [np.zeros_like(mean)]
    while len(mean) > 1:
        left, right = length[::2], length[1::2]
        length = left + right
        left, right = left / length, right / length
        between = _PEAK * 2.0 * left * right * np.abs(mean[::2] - mean[1::2])
        within = left * scales[-1][::2] + right * scales[-1][1::2]
        mean = left * mean[::2] + right * mean[1::2]
        scales.append(np.maximum(within, between))
    for k in range(len(scales) - 2, -1, -1):
        scales[k] = np.maximum(scales[k], np.repeat(scales[k + 1], 2, axis=0))
    return scales


def _prediction_errors(times: Array, values: Array, rounding: Array) -> Array:
    """Return by how much each second point is off the cubic through four of the others."""
    count = min(4, len(times[::2]))
    at, known = times[1::2], times[::2]
    first = np.clip(np.arange(-1, len(at) - 1), 0, len(known) - count)
    stencil = [known[first + i] for i in range(count)]
    error = -values[1::2]
    for i, point in enumerate(stencil):
        weight = np.ones_like(at)
        for j, other in enumerate(stencil):
            if j != i:
                weight *= (at - other) / (point - other)
        error += weight[:, None] * values[::2][first + i]
    error = np.abs(error)
    return np.where(error > rounding, error, 0.0)
