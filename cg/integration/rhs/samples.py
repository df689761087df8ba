"""Inputs of right-hand sides that are given by samples in time.

A curve through samples is a polynomial between them, and may jump. An error estimate sees a curve
only at the few nodes of a step. Steps that have grown where the curve is constant or smooth would
pass over a pulse between two nodes, and accept it. The samples are known before the first step, so
that `Resolution` limits steps in advance: it joins the pieces of a curve in blocks of 2, 4, 8, … as
long as the curve within a block is smooth on the scale of the block. A step is no longer than the
blocks that it touches.

At each level, every second point is predicted by the cubic through four of the others. For a smooth
curve the error of the prediction falls by 16 from a level to the next finer one. A pulse or noise
that is shorter than a block has larger errors at fine levels.

Errors are relative to the variation of their own column: the largest mean deviation from the mean
in any block around them. So units, other columns, and the curve long before or after don't matter.
Errors below ``_IGNORED`` times the tolerance, relative to the variation, are ignored: the integral
of all ignored deviations is within the tolerance of the integral of the variation.
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_right
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.support.arrays import Array, check_finite, read_only, real_array
from cg.support.checks import check_choice, check_flag, check_number, texts_of
from cg.support.frozen import ReadOnly

_LINE_ROUNDING = 4 * float(np.finfo(float).eps)  # relative error of times and values of lines


def curve_of(times: Array, values: Array, kind: str, causal: bool) -> tuple[Array, Array]:
    """Return the starts of the pieces of a curve and their polynomials, shape (powers, pieces, …).

    Coefficients of the power 0 come first; times count from the start of the piece.
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
    mean = values.mean(axis=0)  # sums of deviations from it have smaller rounding errors
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(steps * (values - mean), axis=0)])
    pieces = np.ascontiguousarray(CubicSpline(times, sums).derivative().c[::-1])
    pieces[0] += mean
    return times[:-1], pieces


def jumps_of_lines(times: Array, values: Array, slopes: Array) -> Array:
    """Return whether lines or their slopes jump at inner edges by more than rounding."""
    length = np.diff(times)[:, None]
    sizes = np.abs(values) + np.abs(slopes) * np.maximum(length, np.abs(times[1:, None]))
    rounding = _LINE_ROUNDING * np.maximum(sizes[1:], sizes[:-1])
    bends = np.abs(np.diff(slopes, axis=0)) * np.minimum(length[1:], length[:-1])
    ends = values[:-1] + slopes[:-1] * length[:-1]
    return np.asarray((bends > rounding) | (np.abs(values[1:] - ends) > rounding))


_IGNORED = 0.08  # deviation between samples of a spline whose kinks D d^p are 1, see `corners`
_BLOCKS_PER_STEP = 2.0  # blocks in the longest step, whose nodes are closer than a block
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
        """Return the largest relative size at each inner point, for sizes (points - 2, columns)."""
        scale = self._scales[0][: self._pieces]
        scale = np.maximum(scale[1:], scale[:-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(sizes > 0.0, sizes / scale, 0.0)
        return np.asarray(relative.max(axis=1))

    def max_steps_at(self, tolerance: float) -> Array:
        """Return the largest step sizes, rows (t, limit).

        Steps that start between t and the time of the next row are at most limit long.
        """
        allowed = tolerance**0.25
        level = np.zeros(len(self._times) - 1, dtype=np.int8)
        errors = np.zeros_like(self._scales[0])
        levels = zip(self._scales[1:], self._errors, strict=True)
        for k, (scale, raw_errors) in enumerate(levels, 1):
            relevant = np.where(raw_errors > _IGNORED * tolerance * scale, raw_errors, 0.0)
            errors = np.maximum(_FALL * np.maximum(errors[::2], errors[1::2]), relevant)
            smooth = (errors <= allowed * scale).all(axis=1)
            if not smooth.any():
                break
            level.reshape(-1, 2**k)[smooth] = k
        pieces = np.arange(self._pieces)
        sizes = 2 ** level[: self._pieces].astype(np.int64)
        first = pieces[pieces % sizes == 0]  # of each block of 2^level pieces
        starts, ends = self._times[first], self._times[first + sizes[first]]
        return np.stack([starts, _BLOCKS_PER_STEP * (ends - starts)], axis=1)


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
    """Return the largest variation around each block, for blocks of 1, 2, 4, … pieces."""
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
    """Return the distance of every second point from the cubic through four of the others."""
    count = min(4, len(times[::2]))
    at, nodes = times[1::2], times[::2]
    starts = np.clip(np.arange(-1, len(at) - 1), 0, len(nodes) - count)
    stencil = [nodes[starts + i] for i in range(count)]
    error = -values[1::2]
    for i, point in enumerate(stencil):
        others = stencil[:i] + stencil[i + 1 :]
        weight = np.prod([(at - other) / (point - other) for other in others], axis=0)
        error += weight[:, None] * values[::2][starts + i]
    error = np.abs(error)
    return np.where(error > rounding, error, 0.0)


_MIN_COUNT = {"hold": 1, "linear": 2, "cubic": 2, "averages": 1}
_VALUES_AT_A_TIME = 64  # values whose curves `by_values` makes at a time
_VALUE_ROUNDING = 64 * float(np.finfo(float).eps)  # relative error of values and of their jumps
_ENDS = 4  # units of rounding by which a time may lie outside, since f is evaluated beside corners


class Samples(ReadOnly):
    r"""A function of time given by samples, as an input of right-hand sides.

    Pass it as ``inputs`` to an integration, whose functions then get its value: ``f(t, y, u)``.
    Steps end where the curve or its derivative jumps, and the right-hand side sees the curve on
    its side of each such time. Steps of chosen sizes also end at knots of splines where jumps of
    higher derivatives matter to the relative tolerance, and are no longer than what the samples
    resolve, so that they don't pass over pulses.

    Parameters
    ----------
    times
        Shape ``(n,)``. Times in increasing order; with ``kind="averages"`` the n + 1 edges of n
        intervals.
    values
        Shape ``(n, ...)``. The values; ``u`` has the shape of one of them, and is a float if that
        is ``()``. With ``members=True`` the shape is ``(members, n, ...)``, and each member of an
        ensemble has its own.
    kind
        One of ``"hold"``, ``"linear"``, ``"cubic"``, ``"averages"``. The curve: each value from its
        time on until the next one; linear between the times; the cubic spline with not-a-knot ends;
        or, for values that are means over the intervals, such as those of gyroscopes that
        integrate, the derivative of the cubic spline through the cumulative sums, which has these
        means and is continuous.
    end
        Time to which the last value of ``"hold"`` lasts; by default it has no end.
    causal
        Whether the curve of ``"averages"`` uses no later intervals, as is needed where samples
        arrive during the integration: it is linear in each interval, with the mean of that
        interval and the slope between the middle of the previous one and its own; the first one
        is constant. It jumps at the edges.
    members
        Whether ``values`` has a first axis for the members of an ensemble.

    Examples
    --------
    >>> thrust = Samples([0.0, 0.5, 1.0], [1.0, 0.0, 2.0])
    >>> thrust(0.25), thrust(0.5), thrust(7.0)
    (1.0, 0.0, 2.0)
    >>> gyro = Samples([0.0, 0.1, 0.2, 0.3], [[0.0], [1.0], [0.0]], kind="averages")
    >>> gyro(0.15).round(8)
    array([1.08333333])
    """

    def __init__(
        self, times: ArrayLike, values: ArrayLike, kind: str = "hold", *, end: float | None = None,
        causal: bool = False, members: bool = False,
    ) -> None:  # fmt: skip
        check_choice("kind", kind, _MIN_COUNT)
        self.kind = kind
        self.causal = check_flag("causal", causal)
        if self.causal and kind != "averages":
            raise ValueError(f"causal must be False for kind {kind!r}, whose curve needs no mean")
        self.times = _read_times(times)
        self.values = _read_values(values, len(self.times), kind, check_flag("members", members))
        self.members = len(self.values) if members else None
        self.end = math.inf if kind == "hold" else float(self.times[-1])
        if end is not None:
            self.end = self._read_end(end)
        by_time = np.moveaxis(self.values, 1, 0) if members else self.values
        self._edges, self._pieces = curve_of(self.times, by_time, kind, self.causal)
        first, last = float(self.times[0]), float(self.times[-1])
        beyond = _ENDS * math.ulp(max(abs(first), abs(last)))
        self._span = first - beyond, self.end + beyond
        # compiled code reads them as (powers, pieces, width), with a first axis for members
        flat = self._pieces.reshape(*self._pieces.shape[: 3 if members else 2], -1)
        self._numbers = np.ascontiguousarray(np.moveaxis(flat, 2, 0)) if members else flat
        self._pieces.setflags(write=False)

    def __getstate__(self) -> dict[str, Any]:
        # without cached properties, since `of_members` copies the object and gives it other values
        cached = {n for n, value in vars(Samples).items() if isinstance(value, cached_property)}
        return {name: value for name, value in super().__getstate__().items() if name not in cached}

    @cached_property
    def _rows(self) -> tuple[list[float], list[float], list[list[Any]]]:
        """Bounds for bisection, the starts of the pieces, and their polynomials."""
        by_piece = np.moveaxis(self._pieces, 0, 1)
        rows = by_piece.tolist() if by_piece.ndim == 2 else list(map(list, by_piece))
        starts = self._edges.tolist()
        return [-math.inf, *starts[1:]], starts, rows

    def _read_end(self, end: Any) -> float:
        value = check_number("end", end)
        if self.kind != "hold":
            raise ValueError(f"end must be None for kind {self.kind!r}, got {end!r}")
        if not self.times[-1] < value < np.inf:
            raise ValueError(f"end must be after the last time {self.times[-1]:.17g}, got {end!r}")
        return value

    def __repr__(self) -> str:
        members = "" if self.members is None else f", members={self.members}"
        return f"Samples({len(self.times)} times, shape={self.shape}, kind={self.kind!r}{members})"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the value at one time."""
        return self.values.shape[1 if self.members is None else 2 :]

    def corners(self, tolerance: float | None = None) -> Array:
        """Return the times at which steps end: jumps of the curve or its derivative, and knots.

        A spline of degree p differs from a smooth function through its samples by some 0.08 D d^p,
        where D are jumps of the highest coefficient and d the lengths of pieces. Knots at which D
        d^p exceeds the relative tolerance times the variation are returned, none without a
        tolerance.
        """
        inner = self._edges[1:]
        if not len(inner):
            return inner
        if self._is_spline:
            return inner[:0] if tolerance is None else inner[self._kinks > tolerance]
        pieces = self._pieces.reshape(*self._pieces.shape[:2], -1)
        jumps = np.abs(np.diff(pieces[0], axis=0))
        if len(pieces) > 1:
            jumps = jumps_of_lines(self.times, *pieces)
        return np.asarray(inner[jumps.any(axis=1)])

    def max_steps_at(self, tolerance: float) -> Array:
        """Return the largest step sizes, see `Resolution.max_steps_at`."""
        if not self._is_spline or len(self._edges) < 2:
            return np.empty((0, 2))
        return self._resolution.max_steps_at(tolerance)

    @property
    def _is_spline(self) -> bool:
        return self.kind in ("cubic", "averages") and not self.causal

    @cached_property
    def _resolution(self) -> Resolution:
        """The curve at its edges, on all scales."""
        pieces = self._pieces.reshape(*self._pieces.shape[:2], -1)
        length = self.times[-1] - self._edges[-1]
        last = np.polynomial.polynomial.polyval(length, pieces[:, -1])
        return Resolution(self.times, np.concatenate([pieces[0], last[None]]), self._rounding)

    @cached_property
    def _rounding(self) -> Array:
        size = np.abs(self._pieces[0].reshape(len(self._edges), -1)).max(axis=0)
        return np.asarray(_VALUE_ROUNDING * size)

    @cached_property
    def _kinks(self) -> Array:
        """Return D d^p of a spline at each inner edge, relative to the variation around it."""
        pieces = self._pieces.reshape(*self._pieces.shape[:2], -1)
        length = np.diff(self.times)
        jumps = np.abs(np.diff(pieces[-1], axis=0))
        jumps *= np.maximum(length[1:], length[:-1])[:, None] ** (len(pieces) - 1)
        kinks = self._resolution.kinks(np.where(jumps > self._rounding, jumps, 0.0))
        if len(kinks) > 2:  # not-a-knot: the outer knots have no kink, but their pieces are as long
            kinks[[0, -1]] = kinks[[1, -2]]
        return kinks

    def __call__(self, t: float, member: int | None = None) -> Any:
        """Return the value at a time; at a jump the value after it.

        Parameters
        ----------
        t
            One time.
        member
            The member of an ensemble, for values of several members. All of them by default.
        """
        return self.reader(member)(check_number("t", t))

    def reader(self, member: int | None = None) -> Callable[[float], Any]:
        """Return the curve, or the curve of a member, as a function that takes little time."""
        (bounds, starts, rows), check_span = self._rows, self.check_span
        low, high = self._span
        column = None if self.members is None else member

        def value_at(t: float) -> Any:
            if not low <= t <= high:
                check_span(t, t)
            piece = bisect_right(bounds, t) - 1
            s = t - starts[piece]
            *others, value = rows[piece]
            for row in reversed(others):
                value = row + s * value
            # + makes a new array, which the caller may change
            return +value if column is None else +value[column]

        return value_at

    def at(self, t: Array, members: Any = None) -> Array:
        """Return the values at times, shape ``(k, ...)``, each of a member if there are members."""
        self.check_span(float(t.min()), float(t.max()))
        piece = np.maximum(np.searchsorted(self._edges, t, side="right") - 1, 0)
        index = (slice(None), piece) if self.members is None else (slice(None), piece, members)
        rows = self._pieces[index]
        s = (t - self._edges[piece]).reshape(-1, *[1] * (rows.ndim - 2))
        value: Array = rows[-1]
        for row in rows[-2::-1]:
            value = row + s * value
        return value

    def shifted(self, amount: Array) -> Samples:
        """Return the curve with an amount added to it at all times."""
        end = self.end if self.kind == "hold" and self.end < math.inf else None
        values = self.values + amount.reshape(self.shape)
        options = {"causal": self.causal, "members": self.members is not None}
        return Samples(self.times, values, self.kind, end=end, **options)

    def by_values(self, t: Array, by_curve: Array) -> Array:
        """Return the derivatives of a sum over times with respect to the values of the samples.

        ``by_curve`` has those of its terms with respect to the curve, shape (times, width).
        """
        piece = np.maximum(np.searchsorted(self._edges, t, side="right") - 1, 0)
        s = (t - self._edges[piece])[:, None]
        sums = np.zeros((*self._pieces.shape[:2], by_curve.shape[1]))
        for power, total in enumerate(sums):
            np.add.at(total, piece, by_curve * s**power)
        if self.kind == "hold":
            return np.asarray(sums[0].reshape(self.values.shape))
        # the pieces are linear in the values, so that the transpose of this map remains
        count = len(self.values)
        rows = []
        for first in range(0, count, _VALUES_AT_A_TIME):
            units = np.eye(count, min(_VALUES_AT_A_TIME, count - first), -first)
            pieces = curve_of(self.times, units, self.kind, self.causal)[1]
            rows.append(np.tensordot(pieces, sums, ((0, 1), (0, 1))))
        return np.asarray(np.concatenate(rows).reshape(self.values.shape))

    def of_members(self, members: slice) -> Samples:
        """Return the curves of some members."""
        if self.members is None:
            return self
        curve = copy.copy(self)
        curve.values, curve._numbers = self.values[members], self._numbers[members]
        curve._pieces = self._pieces[:, :, members]
        curve.members = len(curve.values)
        return curve

    def check_span(self, start: float, end: float, name: str = "t") -> None:
        """Raise ValueError unless the curve covers two times and those between, up to rounding."""
        low, high = self._span
        if not (low <= min(start, end) and max(start, end) <= high):
            low_text, high_text, *got = texts_of(self.times[0], self.end, start, end)
            is_span = start < end or end < start  # else one time, or NaN
            raise ValueError(
                f"{name} must lie within the times of the samples, {low_text} to {high_text}, "
                f"got {'({}, {})'.format(*got) if is_span else got[0]}"
            )


def _read_times(times: ArrayLike) -> Array:
    array = real_array(times, "times")
    if array.ndim != 1 or not array.size:
        raise ValueError(f"times must have shape (n,), got {array.shape}")
    growing = array[1:] > array[:-1]
    bounded = math.isfinite(array.item(0)) and math.isfinite(array.item(-1))
    if not bounded or np.count_nonzero(growing) < len(growing):  # faster than all()
        check_finite("times", array)
        index = int(np.argmin(growing))
        before, got = texts_of(*array[index : index + 2])
        raise ValueError(f"times must increase, got {got} after {before} at [{index + 1}]")
    return read_only(array)


def _read_values(values: ArrayLike, times: int, kind: str, members: bool) -> Array:
    array = real_array(values, "values")
    count = times - (kind == "averages")
    needed = _MIN_COUNT[kind]
    if count < needed:
        raise ValueError(f"times must have at least {needed + times - count} entries, got {times}")
    lead = array.shape[: 2 if members else 1]
    if lead[-1:] != (count,) or len(lead) != (2 if members else 1) or 0 in array.shape:
        shape = f"(members, {count}, ...)" if members else f"({count}, ...)"
        edges = ", one less than the edges" if kind == "averages" else ""
        raise ValueError(f"values must have shape {shape}{edges}, got {array.shape}")
    check_finite("values", array)
    return read_only(array)
