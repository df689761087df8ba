"""Inputs of right-hand sides that are given by samples in time."""

from __future__ import annotations

import copy
import math
from bisect import bisect_right
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.integration.rhs.curves import curve_of, jumps_of_lines
from cg.integration.rhs.resolution import Resolution
from cg.support.arrays import Array, check_finite, real_array
from cg.support.checks import check_flag
from cg.support.copies import ReadOnly
from cg.support.times import apart

_LEAST = {"hold": 1, "linear": 2, "cubic": 2, "averages": 1}
_BLOCK = 64  # number of values whose curves are made at a time
_ROUNDING = 64 * float(np.finfo(float).eps)  # relative error of values, and so of jumps
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
        self,
        times: ArrayLike,
        values: ArrayLike,
        kind: str = "hold",
        *,
        end: float | None = None,
        causal: bool = False,
        members: bool = False,
    ) -> None:
        if not isinstance(kind, str) or kind not in _LEAST:
            raise ValueError(f"kind must be one of {', '.join(_LEAST)}, got {kind!r}")
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
        flat = self._pieces.reshape(*self._pieces.shape[: 3 if members else 2], -1)
        self._numbers = np.ascontiguousarray(np.moveaxis(flat, 2, 0)) if members else flat
        self._pieces.flags.writeable = False

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        for name in ("_rows", "_resolution", "_rounding", "_kinks"):
            state.pop(name, None)
        return state

    @cached_property
    def _rows(self) -> tuple[list[float], list[float], list[list[Any]]]:
        """What a search needs, the starts of the pieces, and their polynomials."""
        by_piece = np.moveaxis(self._pieces, 0, 1)
        rows = by_piece.tolist() if by_piece.ndim == 2 else list(map(list, by_piece))
        starts = self._edges.tolist()
        return [-math.inf, *starts[1:]], starts, rows

    def _read_end(self, end: Any) -> float:
        value = real_array(end, "end")
        if self.kind != "hold":
            raise ValueError(f"end must be None for kind {self.kind!r}, got {end!r}")
        if value.shape != () or not self.times[-1] < value < np.inf:
            raise ValueError(f"end must be after the last time {self.times[-1]:.17g}, got {end!r}")
        return float(value)

    def __repr__(self) -> str:
        of = "" if self.members is None else f", members={self.members}"
        return f"Samples({len(self.times)} times, shape={self.shape}, kind={self.kind!r}{of})"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the value at one time."""
        return self.values.shape[1 if self.members is None else 2 :]

    def numbers(self) -> tuple[Array, Array, int]:
        """Return what compiled code evaluates: starts and coefficients of the pieces.

        The coefficients have the shape ``(powers, pieces, width)``, with a first axis for members;
        the last result is the bytes from one member to the next. The arrays live as long as this
        object.
        """
        return self._edges, self._numbers, self._numbers[0].nbytes if self.members else 0

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
            jumps = jumps_of_lines(self.times, pieces[0], pieces[1], self.causal)
        corners: Array = inner[jumps.any(axis=1)]
        return corners

    def longest_steps(self, tolerance: float) -> Array:
        """Return times and how long steps may be from each on, shape (n, 2)."""
        if not self._is_spline or len(self._edges) < 2:
            return np.empty((0, 2))
        return self._resolution.longest_steps(tolerance)

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
        return np.asarray(_ROUNDING * size)

    @cached_property
    def _kinks(self) -> Array:
        """Return D d^p of a spline at each inner edge, relative to the variation around it."""
        pieces = self._pieces.reshape(*self._pieces.shape[:2], -1)
        length = np.diff(self.times)
        jumps = np.abs(np.diff(pieces[-1], axis=0))
        jumps *= np.maximum(length[1:], length[:-1])[:, None] ** (len(pieces) - 1)
        kinks = self._resolution.kinks(np.where(jumps > self._rounding, jumps, 0.0))
        if len(kinks) > 2:  # the outer knots are none, but their pieces are as long as others
            kinks[[0, -1]] = kinks[[1, -2]]
        return kinks

    def __call__(self, t: float, member: int | None = None) -> Any:
        """Return the value at a time, that after a jump.

        Parameters
        ----------
        t
        member
            The member of an ensemble, for values of several members. All of them by default.
        """
        if not isinstance(t, float) and np.ndim(t):
            raise ValueError(f"t must be one time, got shape {np.shape(t)}")
        return self.reader(member)(t)

    def reader(self, member: int | None = None) -> Callable[[float], Any]:
        """Return the curve, or that of a member, as a function that takes little time."""
        (search, starts, rows), outside = self._rows, self.check_span
        low, high = self._span
        own = None if self.members is None else member

        def hold(t: float) -> Any:
            if not low <= t <= high:
                outside(t, t)
            (value,) = rows[bisect_right(search, t) - 1]
            return +value if own is None else +value[own]  # an array of the caller's, as below

        def polynomial(t: float) -> Any:
            if not low <= t <= high:
                outside(t, t)
            piece = bisect_right(search, t) - 1
            s = t - starts[piece]
            *others, value = rows[piece]
            for row in reversed(others):
                value = row + s * value
            return value if own is None else value[own]

        return hold if self.kind == "hold" else polynomial

    def at(self, t: Array, members: Any = None) -> Array:
        """Return the values at times, shape ``(k, ...)``, each of a member if there are members."""
        self.check_span(float(t.min()), float(t.max()))
        piece = np.maximum(np.searchsorted(self._edges, t, side="right") - 1, 0)
        which = (slice(None), piece) if self.members is None else (slice(None), piece, members)
        rows = self._pieces[which]
        s = (t - self._edges[piece]).reshape(-1, *[1] * (rows.ndim - 2))
        value: Array = rows[-1]
        for row in rows[-2::-1]:
            value = row + s * value
        return value

    def shifted(self, amount: Array) -> Samples:
        """Return the curve with an amount added to it at all times."""
        end = self.end if self.kind == "hold" and self.end < math.inf else None
        values = self.values + amount.reshape(self.shape)
        return Samples(self.times, values, self.kind, end=end, causal=self.causal)

    def by_values(self, t: Array, by_curve: Array) -> Array:
        """Return the derivatives by all values of a sum over times.

        ``by_curve`` has its derivatives by the curve at the times, shape (times, width).
        """
        piece = np.maximum(np.searchsorted(self._edges, t, side="right") - 1, 0)
        s = (t - self._edges[piece])[:, None]
        sums = np.zeros((*self._pieces.shape[:2], by_curve.shape[1]))
        for power, total in enumerate(sums):
            np.add.at(total, piece, by_curve * s**power)
        if self.kind == "hold":
            held: Array = sums[0].reshape(self.values.shape)
            return held
        # the pieces are linear in the values, so that the transpose of this map remains
        count = len(self.values)
        rows = []
        for first in range(0, count, _BLOCK):
            units = np.eye(count, min(_BLOCK, count - first), -first)
            pieces = curve_of(self.times, units, self.kind, self.causal)[1]
            rows.append(np.tensordot(pieces, sums, ((0, 1), (0, 1))))
        by_values: Array = np.concatenate(rows).reshape(self.values.shape)
        return by_values

    def part(self, members: slice) -> Samples:
        """Return the curves of some members."""
        if self.members is None:
            return self
        part = copy.copy(self)
        part.values, part._numbers = self.values[members], self._numbers[members]
        part._pieces = self._pieces[:, :, members]
        part.members = len(part.values)
        return part

    def check_span(self, start: float, stop: float, name: str = "t") -> None:
        """Raise ValueError unless the curve covers two times and those between, up to rounding."""
        first, last = min(start, stop), max(start, stop)
        low, high = self._span
        if not (low <= first and last <= high):
            low_text, high_text, *got = apart(self.times[0], self.end, start, stop)
            raise ValueError(
                f"{name} must lie within the times of the samples, {low_text} to {high_text}, "
                f"got {got[0] if start == stop else '({}, {})'.format(*got)}"
            )


def _read_times(times: ArrayLike) -> Array:
    array = real_array(times, "times")
    if array.ndim != 1 or not array.size:
        raise ValueError(f"times must have shape (n,), got {array.shape}")
    growing = array[1:] > array[:-1]
    bounded = math.isfinite(array.item(0)) and math.isfinite(array.item(-1))
    if not bounded or np.count_nonzero(growing) < len(growing):  # faster than all()
        check_finite(array, "times")
        place = int(np.argmin(growing))
        before, got = apart(*array[place : place + 2])
        raise ValueError(f"times must increase, got {got} after {before} at [{place + 1}]")
    array.flags.writeable = False
    return array


def _read_values(values: ArrayLike, times: int, kind: str, members: bool) -> Array:
    array = real_array(values, "values")
    count = times - (kind == "averages")
    needed = _LEAST[kind]
    if count < needed:
        raise ValueError(f"times must have at least {needed + times - count} entries, got {times}")
    lead = array.shape[: 2 if members else 1]
    if lead[-1:] != (count,) or len(lead) != (2 if members else 1) or 0 in array.shape:
        shape = f"(members, {count}, ...)" if members else f"({count}, ...)"
        edges = ", one less than the edges" if kind == "averages" else ""
        raise ValueError(f"values must have shape {shape}{edges}, got {array.shape}")
    check_finite(array, "values")
    array.flags.writeable = False
    return array
