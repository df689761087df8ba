"""Functions of the solution: events, which are zeros, and observers, called at output times."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.integration.rhs.compiled import CompiledRhs, compiled_event
from cg.integration.rhs.form import templates_of
from cg.integration.rhs.inputs import WithInput
from cg.integration.rhs.python import Contexts, Rhs, read_finite, read_value
from cg.support.arrays import Array, Points, read_only, real_array
from cg.support.checks import NO_LIMIT, check_choice, check_flag, check_number, check_real
from cg.support.frozen import filled
from cg.support.shared_records import EVENT, OBSERVER, columns_of, fields_of


@dataclass(frozen=True)
class Event:
    """An event: a zero of a function along the solution, where its sign changes.

    In each step signs of the function are compared at both ends, in the middle, and, unless these
    values differ by less than they are from zero, at two more points, all at most 30° of a
    rotation apart; and where a parabola through three values comes near to zero. A function that
    changes much faster than the solution, such as ``sin(100 t)``, needs a ``max_step``.

    Events at the same time happen together, with jumps in the order of the list. Where a jump
    leaves its function at zero, and ``f`` drives it beyond, as in a contact that rests, the
    integration ends with the status -1.

    Functions with SciPy's attributes ``terminal`` and ``direction`` serve as well.

    Parameters
    ----------
    function
        ``function(t, y, *args)`` returns a real number, whose sign changes at an event. It may be
        compiled, ``double (double t, const double *y, void *user_data)``, given as a right-hand
        side may be.
    terminal
        Whether the event ends the integration, or the number of times after which it does; zero
        for never.
    direction
        Positive for zeros where the function increases along the solution, negative where it
        decreases, 0 for both.
    jump
        ``jump(t, y, *args)`` returns the point from which the solution continues, shape
        ``frame.point_shape``.
    period
        Period of a function that is known up to its multiples, such as ``2 * np.pi`` of an angle:
        the event is at all multiples, and where the value wraps there is none. Between two
        comparisons of signs the function must change by less than half a period.
    vectorized
        Whether ``function`` takes many members of an ensemble at a time: times ``(k,)``, points
        ``(k, *frame.point_shape)``, and rows of parameters and inputs, as a vectorized ``f`` of
        `cg.solve_ensemble`. It returns ``k`` numbers. For a single point k is one. ``jump`` takes
        one member in any case.

    Examples
    --------
    A ball that bounces three times, losing a tenth of its speed each time:

    >>> import crouch_grossman as cg
    >>> floor = cg.Event(
    ...     lambda t, y: y[0], direction=-1, terminal=4,
    ...     jump=lambda t, y: [0.0, -0.9 * y[1]],
    ... )
    >>> solution = cg.solve_ivp(
    ...     lambda t, y: [y[1], -9.81], (0, 10), [1.0, 0.0], frame=cg.frames.Euclidean(2),
    ...     events=floor,
    ... )
    >>> solution.t_events[0].round(3)
    array([0.452, 1.264, 1.996, 2.654])
    """

    function: Any
    terminal: bool | int = False
    direction: float = 0.0
    jump: Callable[..., Any] | None = None
    period: float | None = None
    vectorized: bool = False

    def __post_init__(self) -> None:
        self._check("event")

    def _check(self, name: str) -> tuple[int, int]:
        """Return how many times the event may happen before it ends the run, and its sign."""
        if not callable(self.function) and compiled_event(self.function) is None:
            label = "function" if name == "event" else name
            raise TypeError(f"{label} must be callable as event(t, y), got {self.function!r}")
        if self.jump is not None and not callable(self.jump):
            raise TypeError(f"{name}.jump must be callable as jump(t, y), got {self.jump!r}")
        terminal = self.terminal
        # a number that isn't whole would silently be another count
        if isinstance(terminal, bool | np.bool_) or terminal is None:
            count = 1 if terminal else NO_LIMIT
        elif isinstance(terminal, int | float | np.integer) and 0 <= terminal == terminal // 1:
            count = NO_LIMIT if terminal == 0 or terminal > 2**53 else int(terminal)
        else:
            error = ValueError if isinstance(terminal, Real) else TypeError
            raise error(
                f"{name}.terminal must be a bool or a whole number, not negative, got {terminal!r}"
            )
        direction = check_number(f"{name}.direction", self.direction)
        if math.isnan(direction):
            raise ValueError(f"{name}.direction must be a number, got {direction!r}")
        if self.period is not None:
            check_real(f"{name}.period", self.period, positive=True)
        flag = check_flag(f"{name}.vectorized", self.vectorized)
        if flag and compiled_event(self.function) is not None:
            raise ValueError(f"{name}.vectorized must be False for a compiled function, got True")
        return count, int(direction > 0.0) - int(direction < 0.0)


class EventTable:
    """The events of one integration, after checking.

    With ``inputs`` functions in Python get the inputs of a `Reader`, and with ``parameters`` a row
    of parameters. If ``f`` is ``in_python``, compiled functions can't read its data, and need data
    of their own in place of inputs and parameters.

    ``rows`` is the table that compiled code reads, with the entries of `EVENT`.
    """

    def __init__(
        self, events: Any, frame: Frame, *, inputs: bool = False, parameters: bool = False,
        in_python: bool = False,
    ) -> None:  # fmt: skip
        if isinstance(events, Event) or callable(events) or compiled_event(events) is not None:
            events = (events,)
        elif not isinstance(events, Sequence) or isinstance(events, str):
            raise TypeError(f"events must be a function or a sequence of them, got {events!r}")
        flags = {"inputs": inputs, "parameters": parameters, "in_python": in_python}
        self._arguments: tuple[Any, dict[str, Any]] = events, flags
        self.frame, self.parameters = frame, parameters
        self.width = math.prod(frame.point_shape) * frame.dtype.itemsize // 8
        self.events = [_as_event(event) for event in events]
        self.compiled = [compiled_event(event.function) for event in self.events]
        rows = []
        for i, (event, source) in enumerate(zip(self.events, self.compiled, strict=True)):
            count, sign = event._check(f"events[{i}]")
            if in_python and (inputs or parameters) and source and not source.user_address:
                raise ValueError(
                    f"events[{i}] must be in Python with inputs or parameters and an f in Python, "
                    f"got {event.function!r}, which is compiled and has no user_data"
                )
            entries = {
                "function": 0 if source is None else source.address,
                "data": 0 if source is None else source.user_address or -in_python,
                "direction": sign,
                "limit": count,
                "jumps": event.jump is not None,
                "period": event.period or 0.0,
                "vectorized": event.vectorized,
            }
            rows.append(tuple(entries[name] for name in EVENT))
        if inputs:
            self.events = [_with_input(event) for event in self.events]
        self.rows: NDArray[np.void] = np.array(rows, dtype=columns_of(EVENT))

    def __reduce__(self) -> tuple[Any, ...]:
        events, flags = self._arguments
        return partial(EventTable, **flags), (events, self.frame)

    def on_frame(self, frame: Frame) -> EventTable:
        """Return the events on another frame of the same points."""
        events, flags = self._arguments
        return EventTable(events, frame, **flags)

    def __len__(self) -> int:
        return len(self.events)

    @property
    def has_terminal(self) -> bool:
        """Whether an event can end the integration."""
        return bool((self.rows["limit"] < NO_LIMIT).any())

    def value(self, index: int, t: float, y: Points, arguments: tuple[Any, ...]) -> float:
        """Return the value of an event's function in Python, after checking it."""
        if self.events[index].vectorized:
            if self.parameters:
                arguments = *arguments[:-1], arguments[-1][None]
            return float(self.values(index, np.array([t]), y[None], arguments)[0])
        y.setflags(write=False)
        raw = self.events[index].function(t, y, *arguments)
        if not (isinstance(raw, float) and math.isfinite(raw)):
            raw = float(read_finite(raw, f"events[{index}]", (), t, number=True))
        return self.wrapped(index, raw)

    def values(self, index: int, t: Array, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return the values of an event's vectorized function, after checking them."""
        t.setflags(write=False)
        y.setflags(write=False)
        event = self.events[index]
        values: Array = event.function(t, y, *arguments)
        plain = type(values) is np.ndarray and values.dtype == np.float64
        if not plain or values.shape != t.shape:
            values = read_value(values, f"events[{index}]", t.shape, t, "member")
        if not np.isfinite(values).all():
            bad = int(np.flatnonzero(~np.isfinite(values))[0])
            read_finite(values.item(bad), f"events[{index}]", (), t[bad])
        if event.period is not None:
            values = np.array([self.wrapped(index, value) for value in values.tolist()])
        return values

    def wrapped(self, index: int, value: float) -> float:
        """Return a value of an event's function, moved by periods to the value nearest to zero."""
        period = self.events[index].period
        return value if period is None else math.remainder(value, period)

    def jump(
        self, index: int, t: float, y: Points, arguments: tuple[Any, ...],
        tolerance: float = MEMBERSHIP_TOLERANCE,
    ) -> Points:  # fmt: skip
        """Return the point after a jump, after checking that it is near the manifold."""
        y.setflags(write=False)
        jump = self.events[index].jump
        assert jump is not None
        name = f"events[{index}].jump(t, y)"
        return self.frame.check_point(jump(t, y, *arguments), tolerance=tolerance, name=name)


def _with_input(event: Event) -> Event:
    """Return an event whose functions in Python get inputs."""
    function, jump = event.function, event.jump
    if compiled_event(function) is None:
        function = WithInput(function)
    return replace(event, function=function, jump=None if jump is None else WithInput(jump))


def _as_event(event: Any) -> Event:
    if isinstance(event, Event):
        return event
    terminal, direction = getattr(event, "terminal", False), getattr(event, "direction", 0.0)
    # checked later, with its index in messages; other fields are those of the class
    return filled(Event, {"function": event, "terminal": terminal, "direction": direction})


class ObserverRecord(ctypes.Structure):
    """The record of an observer in compiled code."""

    _fields_ = fields_of(OBSERVER)


@dataclass(frozen=True, eq=False)
class Observer:
    """A function that is evaluated at output times, after checking."""

    function: Any  # in Python, or a list of compiled ones
    frame: Frame  # frame of the points that it is given
    shape: tuple[int, ...]  # shape of its value at one time
    keeps_points: bool  # whether the points are stored as well

    name: ClassVar[str] = "observe"  # name of the argument
    entry: ClassVar[str] = "observer"  # name of its entry in the record of a run

    def check(self, value: Any, t: float, _: Points) -> Array:
        """Return a value as an array, after checking it."""
        return read_finite(value, self.name, self.shape, t)

    def make_record(self, rhs: Rhs) -> ObserverRecord:
        """Return the record in compiled code; it keeps alive the objects whose addresses it has."""
        kept: Any
        if isinstance(self.function, list):
            data, stride = 0, 0
            if isinstance(rhs, CompiledRhs):
                _, data, stride = rhs.addresses()
            elif rhs.extra.inputs is not None:
                raise ValueError(
                    f"{self.name} must be in Python with inputs if f is, got a compiled function"
                )
            elif (numbers := rhs.extra.parameters) is not None:
                data, stride = numbers.ctypes.data, numbers.strides[0]
            kept = EventTable(self.function, self.frame).rows
            function, functions, table = 0, len(kept), kept.ctypes.data
        else:
            templates = templates_of(self.frame, self.shape)
            kept = Contexts(self.function, rhs.extra, rhs.extra.members, templates, self.check)
            function, data, stride = kept.addresses()
            functions, table = 0, 0
        record = ObserverRecord(self.count, functions, table, function, data, stride)
        record.kept = kept
        return record

    @property
    def count(self) -> int:
        """Number of values at one time."""
        return math.prod(self.shape)


@dataclass(frozen=True, eq=False)
class StepFunction(Observer):
    """The function of step sizes of splitting methods, after checking."""

    name = entry = "step_function"

    def check(self, value: Any, t: float, _: Points) -> Array:
        """Return a value as an array, after checking it."""
        number = read_finite(value, self.name, (), t, number=True)
        if not number > 0.0:
            raise ValueError(
                f"step_function must return a positive number, got {value!r} at t = {t:.17g}"
            )
        return number


def observer_of(
    observe: Any, store: Any, frame: Frame, rhs: Rhs, t: float, y: Points
) -> Observer | None:
    """Return the observer at output times, after calling it at the initial point."""
    check_choice("store", store, ("all", "observed"))
    keeps_points = store == "all"
    if observe is None:
        if not keeps_points:
            raise ValueError(f"observe must be given with store={store!r}, got None")
        return None
    if compiled_event(observe) is not None:
        return Observer([observe], frame, (), keeps_points)
    if isinstance(observe, Sequence) and observe and all(map(compiled_event, observe)):
        return Observer(list(observe), frame, (len(observe),), keeps_points)
    if not callable(observe):
        raise TypeError(
            "observe must be callable as observe(t, y), or a list of compiled functions, got "
            f"{observe!r}"
        )
    if rhs.extra.inputs is not None:
        observe = WithInput(observe)
    value = observe(t, read_only(y.copy()), *rhs.extra.arguments(0))
    shape = real_array(value, "the result of observe").shape
    if 0 in shape:
        raise ValueError(f"observe must return at least one number, got shape {shape}")
    return Observer(observe, frame, shape, keeps_points)
