"""Events: where a function of the solution changes sign."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy

from cg.frames.arrays import Array, Points
from cg.integration.interpolant import Interpolant

EventFunction = Callable[..., Any]

_TOLERANCE = 4.0 * float(np.finfo(np.float64).eps)
# Near zeros of high multiplicity Brent's method bisects for each bit, again and again.
_MOST_ITERATIONS = 60**2

Within = Callable[[], Interpolant]
"""Gives the solution within the step that is looked at; called only if it is needed."""


class Event:
    """A function whose zeros along the solution are wanted.

    Parameters
    ----------
    function
        ``function(t, y, *args)`` returns a real number.  As in SciPy its attribute ``terminal``
        (False unless present) tells whether the event ends the integration, or after how many
        times, where zero is never; ``direction`` (0 unless present) restricts it to zeros where
        the function increases (positive) or decreases (negative) along the integration.
    index
        Its place in the list, for messages.
    args
        Further arguments.

    Raises
    ------
    TypeError
        If ``function`` isn't callable.
    ValueError
        If an attribute has an impossible value.
    """

    def __init__(self, function: EventFunction, index: int, args: tuple[Any, ...]) -> None:
        if not callable(function):
            raise TypeError(f"events[{index}] must be callable as event(t, y), got {function!r}")
        terminal = getattr(function, "terminal", False)
        direction = getattr(function, "direction", 0)
        # Any number that isn't a whole one would silently mean another count.
        if isinstance(terminal, bool | np.bool_) or terminal is None:
            self.most = 1.0 if terminal else math.inf
        elif isinstance(terminal, int | float | np.integer) and _is_count(terminal):
            self.most = math.inf if terminal == 0 or terminal > 2**53 else float(terminal)
        else:
            raise ValueError(
                f"events[{index}].terminal must be a bool or a whole number, not negative, got "
                f"{terminal!r}"
            )
        try:
            self.direction = float(direction)
        except (TypeError, ValueError):
            self.direction = math.nan
        if math.isnan(self.direction):
            raise ValueError(f"events[{index}].direction must be a number, got {direction!r}")
        self.function = function
        self.index = index
        self.args = args
        self.value = math.nan
        self.times: list[float] = []
        self.points: list[Points] = []

    def __call__(self, t: float, y: Points) -> float:
        """Return the function's value after checking it."""
        visible = y.view()
        visible.flags.writeable = False
        raw = self.function(t, visible, *self.args)
        if isinstance(raw, bool | np.bool_) or getattr(raw, "dtype", None) == np.bool_:
            raise ValueError(
                f"events[{self.index}] must return a real number that changes sign, got the bool "
                f"{raw!r} at t = {t:.17g}"
            )
        try:
            given = np.asarray(raw)
            if given.dtype.kind not in "iufO" or np.ma.is_masked(raw):  # complex ones lose a part
                raise TypeError("not real")
            value = float(given.item())
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(
                f"events[{self.index}] must return a real number, got {raw!r} at t = {t:.17g}"
            ) from error
        if not math.isfinite(value):
            raise ValueError(
                f"events[{self.index}] must return a finite number, got {value} at t = {t:.17g}"
            )
        return value

    def root(self, t0: float, t1: float, y1: Points, within: Within) -> float | None:
        """Return at which fraction of a step the function changes sign, or None if it doesn't.

        Parameters
        ----------
        t0, t1
            The ends of the step.
        y1
            The point at its end.
        within
            The solution within it.
        """
        before, self.value = self.value, self(t1, y1)
        # A zero at the very beginning of a step was either found at the end of the last step or
        # is the initial point, which nothing has led to.
        up = before < 0.0 <= self.value and self.direction >= 0.0
        down = before > 0.0 >= self.value and self.direction <= 0.0
        if not (up or down):
            return None
        if self.value == 0.0:
            return 1.0
        ends = {0.0: before, 1.0: self.value}
        solution = within()

        def value(theta: float) -> float:
            if theta in ends:
                return ends[theta]
            return self(t0 + theta * (t1 - t0), point_at(solution, theta))

        # In fractions of the step, the tolerance means the same in any unit and origin of time.
        theta = scipy.optimize.brentq(
            value, 0.0, 1.0, xtol=_TOLERANCE, rtol=_TOLERANCE, maxiter=_MOST_ITERATIONS
        )
        return float(theta)


def point_at(solution: Interpolant, theta: float) -> Points:
    """Return the point at a fraction of a single step."""
    point: Points = solution(np.zeros(1, dtype=np.intp), np.array([theta]))[0]
    return point


def _is_count(number: float | np.integer) -> bool:
    return bool(number >= 0 and number == number // 1)


class EventLog:
    """The events of one integration.

    Parameters
    ----------
    events
        A function, a sequence of them, or None.
    args
        Further arguments of the functions.

    Raises
    ------
    TypeError, ValueError
        As `Event` does.
    """

    def __init__(self, events: Any, args: tuple[Any, ...] = ()) -> None:
        if events is None:
            functions: Sequence[Any] = ()
        elif callable(events):
            functions = (events,)
        elif isinstance(events, Sequence) and not isinstance(events, str):
            functions = events
        else:
            raise TypeError(f"events must be a function or a sequence of them, got {events!r}")
        self.events = [Event(function, i, args) for i, function in enumerate(functions)]

    def __bool__(self) -> bool:
        return bool(self.events)

    def start(self, t: float, y: Points) -> None:
        """Evaluate all functions at the initial point."""
        for event in self.events:
            event.value = event(t, y)

    def record(self, t0: float, t1: float, y1: Points, within: Within) -> float | None:
        """Record what happens within a step; return the fraction of it at which that ends it all.

        Events after the one that ends it are not recorded.  The parameters are those of
        `Event.root`.
        """
        found = [(x, e) for e in self.events if (x := e.root(t0, t1, y1, within)) is not None]
        for theta, event in sorted(found, key=lambda pair: pair[0]):
            event.times.append(t1 if theta == 1.0 else t0 + theta * (t1 - t0))
            event.points.append(y1 if theta == 1.0 else point_at(within(), theta))
            if len(event.times) >= event.most:
                return theta
        return None

    def times(self) -> list[Array]:
        """Return the times of each event."""
        return [np.array(event.times, dtype=np.float64) for event in self.events]

    def points(self, y0: Points) -> list[Points]:
        """Return the points of each event, shaped like ``y0`` with one more leading axis."""
        shape = (-1, *y0.shape)
        return [np.array(e.points, dtype=y0.dtype).reshape(shape) for e in self.events]
