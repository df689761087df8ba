"""Inputs of an integration: curves through samples, as its functions get them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cg.integration.rhs.samples import Samples
from cg.support.arrays import Array, address_of, check_finite, real_array
from cg.support.shared_records import INPUT, columns_of
from cg.tables import MethodTable

_ABSCISSA_ERROR = 1e-15  # largest rounding error of an abscissa


@dataclass(frozen=True, eq=False)
class Inputs:
    """The inputs of an integration: one curve through samples, or several with their own times."""

    curves: tuple[Samples, ...]
    in_tuple: bool  # whether functions get a tuple of values, as the user passed a tuple

    @property
    def members(self) -> int | None:
        """Number of members that have curves of their own, None if all share them."""
        return next((curve.members for curve in self.curves if curve.members is not None), None)

    @property
    def width(self) -> int:
        """Number of values at one time."""
        return sum(math.prod(curve.shape) for curve in self.curves)

    @property
    def scales(self) -> Array:
        """The largest absolute value of each input at any time."""
        tables = [curve.values.reshape(-1, math.prod(curve.shape)) for curve in self.curves]
        return np.concatenate([np.abs(values).max(axis=0) for values in tables])

    @property
    def span(self) -> tuple[float, float]:
        """The times between which all inputs are known."""
        start = max(float(curve.times[0]) for curve in self.curves)
        return start, min(curve.end for curve in self.curves)

    def by_values(self, t: Array, by_inputs: Array) -> Array | tuple[Array, ...]:
        """Return the derivatives of a sum over times with respect to the values of the samples.

        ``by_inputs`` has those of its terms with respect to the inputs, shape (times, width).
        """
        sums = tuple(curve.by_values(t, rows) for curve, rows in self._by_curve(by_inputs))
        return sums if self.in_tuple else sums[0]

    def shifted(self, amounts: Array) -> Inputs:
        """Return the inputs with amounts added to them at all times, shape (width,)."""
        curves = tuple(curve.shifted(amount) for curve, amount in self._by_curve(amounts))
        return replace(self, curves=curves)

    def _by_curve(self, numbers: Array) -> Any:
        """Return each curve with its part of numbers, whose last axis has all inputs."""
        ends = np.cumsum([math.prod(curve.shape) for curve in self.curves])
        return zip(self.curves, np.split(numbers, ends[:-1], axis=-1), strict=True)

    def of_members(self, members: slice) -> Inputs:
        """Return the inputs of some members."""
        if self.members is None:
            return self
        return replace(self, curves=tuple(curve.of_members(members) for curve in self.curves))

    def data_with(self, parameters: Array | None) -> Array:
        """Return the parameters of each member, with room for the inputs after them."""
        if parameters is None:
            return np.zeros((1, self.width))
        return np.concatenate([parameters, np.zeros((len(parameters), self.width))], axis=1)

    def table(self, parameters: Array | None) -> NDArray[np.void]:
        """Return the `INPUT` of each curve; its values come after the parameters of a member."""
        offset = 0 if parameters is None else parameters.shape[1]
        rows: NDArray[np.void] = np.empty(len(self.curves), dtype=columns_of(INPUT))
        for k, curve in enumerate(self.curves):
            starts, numbers = curve._edges, curve._numbers
            stride = numbers[0].nbytes if curve.members else 0
            rows[k] = *numbers.shape[-3:], offset, address_of(starts), address_of(numbers), stride
            offset += numbers.shape[-1]
        return rows

    def corners(self, tolerance: float | None) -> Array:
        """Return the times at which curves aren't smooth, as seen with a tolerance."""
        first, *others = [curve.corners(tolerance) for curve in self.curves]
        return np.unique(np.concatenate([first, *others])) if others else first

    def limits(self, tolerance: float | None) -> Array:
        """Return the largest step sizes, rows (t, limit).

        Steps that start between t and the time of the next row are at most limit long.
        """
        if tolerance is None:
            return np.empty((0, 2))
        tables = [curve.max_steps_at(tolerance) for curve in self.curves]
        limits, *others = [table for table in tables if len(table)] or tables[:1]
        for other in others:
            times = np.union1d(limits[:, 0], other[:, 0])
            sizes = [
                table[np.maximum(np.searchsorted(table[:, 0], times, side="right") - 1, 0), 1]
                for table in (limits, other)
            ]
            limits = np.stack([times, np.minimum(*sizes)], axis=1)
        return limits

    def add_corners(self, segment_ends: Array, start: float, tolerance: float | None) -> Array:
        """Return the ends of segments from a start, with those at corners.

        A corner at an end appears there once more, so that functions are called within the span.
        """
        corners = self.corners(tolerance)
        if not len(corners):
            return segment_ends
        end = float(segment_ends[-1])
        low, high = min(start, end), max(start, end)
        inside = np.union1d(corners[(corners >= low) & (corners <= high)], segment_ends[:-1])
        return np.append(inside if start <= end else inside[::-1], end)

    def check_like(self, before: Inputs) -> None:
        """Raise ValueError unless functions get values of the same shapes as before."""
        pair = before, self
        layouts = [(x.in_tuple, [(c.members, c.shape) for c in x.curves]) for x in pair]
        if layouts[0] != layouts[1]:
            old, new = (
                str(x.curves) if x.in_tuple else f"{x.curves[0]}, not in a tuple" for x in pair
            )
            raise ValueError(f"inputs must be like {old}, got {new}")

    def check_span(self, start: float, end: float, name: str) -> None:
        """Raise ValueError unless all curves cover a span."""
        for curve in self.curves:
            curve.check_span(start, end, name)


def check_member_inputs(
    inputs: list[Any], start: float, end: float, members: int, table: MethodTable, name: str
) -> tuple[Inputs, ...]:
    """Return the inputs of each member, at times of its own, after checking them."""
    if len(inputs) != members:
        raise ValueError(
            f"inputs must be cg.Samples, a tuple of them, or a list of {members} such for the "
            f"members, got a list of {len(inputs)}"
        )
    checked: list[Inputs] = []
    for member, samples in enumerate(inputs):
        try:
            curves = check_inputs(samples, start, end, None, None if member else table, name)
            if curves is None:
                raise TypeError(f"inputs must be cg.Samples, got {samples!r}")
            curves.check_like(checked[0] if checked else curves)
        except (TypeError, ValueError) as error:
            raise type(error)(f"inputs[{member}]: {error}") from None
        checked.append(curves)
    return tuple(checked)


class Reader:
    """The inputs of a member, or of a vectorized function's members, as a function of time."""

    def __init__(self, inputs: Inputs, member: Any) -> None:
        self.inputs, self._member = inputs, member

    def function(self) -> Callable[[float], Any]:
        """Return the inputs of one member as a function that takes little time."""
        first, *others = [curve.reader(self._member) for curve in self.inputs.curves]
        if self.inputs.in_tuple:
            return lambda t: (first(t), *[read(t) for read in others])
        return first

    def __call__(self, t: Any) -> Any:
        """Return the arguments of functions after time and point, or rows for an array of times."""
        if isinstance(t, float):
            return self.function()(t)
        members = np.atleast_1d(self._member)
        members = np.repeat(members, len(t) // len(members))  # times of one follow each other
        values = tuple(curve.at(t, members) for curve in self.inputs.curves)
        return values if self.inputs.in_tuple else values[0]

    def __getitem__(self, index: Any) -> Reader:
        return Reader(self.inputs, self._member[index])

    def numbers(self, t: float) -> Array:
        """Return the inputs at a time as one vector, which compiled functions read."""
        values = [curve.reader(self._member)(t) for curve in self.inputs.curves]
        return np.concatenate([np.ravel(value) for value in values])


class DataReader(Reader):
    """The inputs of a point as compiled code has written them into the data of ``f``."""

    def __init__(self, inputs: Inputs, data: Array) -> None:
        super().__init__(inputs, 0)
        self._data = data

    def function(self) -> Callable[[float], Any]:
        """Return the inputs as a function, which reads them from the data."""
        reads = []
        for curve, numbers in self.inputs._by_curve(self._data):
            values = numbers.reshape(curve.shape)
            reads.append(values.copy if curve.shape else values.item)
        if self.inputs.in_tuple:
            return lambda t: tuple([read() for read in reads])
        return lambda t: reads[0]()


class WithInput:
    """A function of the user that takes inputs, wrapped as one that takes their `Reader`."""

    __slots__ = ("function",)

    def __init__(self, function: Any) -> None:
        self.function = function

    def __call__(self, t: Any, y: Any, reader: Reader, *args: Any) -> Any:
        """Call the function with the inputs at time t in place of their reader."""
        return self.function(t, y, reader(t), *args)


class ExtraArguments(NamedTuple):
    """The arguments of functions besides time and point."""

    args: tuple[Any, ...] = ()
    parameters: Array | None = None  # a row for each member, shape (members, k)
    inputs: Inputs | None = None
    first_member: int | None = None  # its number in the ensemble, for messages

    @property
    def members(self) -> int | None:
        """How many members have data of their own, None if all share theirs."""
        if self.parameters is not None:
            return len(self.parameters)
        return None if self.inputs is None else self.inputs.members

    @property
    def parameter_count(self) -> int | None:
        """Number of parameters, None without any."""
        return None if self.parameters is None else self.parameters.shape[-1]

    def arguments(self, member: Any) -> tuple[Any, ...]:
        """Return the arguments of the functions of a member, or of an array of members."""
        if self.parameters is None and self.inputs is None:
            return self.args
        lead = () if self.inputs is None else (Reader(self.inputs, member),)
        rows = () if self.parameters is None else (self.parameters[member],)
        return (*lead, *self.args, *rows)

    def replaced(self, t: float, parameters: Any, inputs: Any, members: int | None) -> Self:
        """Return the arguments with other data from time t on, after checking; None keeps the old.

        ``members`` is None for a single point.
        """
        extra = self
        if parameters is not None:
            numbers = real_array(parameters, "parameters")
            old = self.parameters
            shape = None if old is None else old.shape[members is None :]
            if numbers.shape != shape:
                expected = "be None, as before" if shape is None else f"have shape {shape}"
                raise ValueError(f"parameters must {expected}, got {numbers.shape}")
            check_finite("parameters", numbers)
            numbers.setflags(write=False)
            extra = extra._replace(parameters=numbers[None] if members is None else numbers)
        if inputs is not None:
            if self.inputs is None:
                raise ValueError(f"inputs must be None, as before, got {inputs!r}")
            curves = check_inputs(inputs, t, t, members, None)
            assert curves is not None
            curves.check_like(self.inputs)
            extra = extra._replace(inputs=curves)
        return extra


NO_EXTRA = ExtraArguments()


def data_at(t: float, arguments: tuple[Any, ...], has_parameters: bool) -> Array | None:
    """Return the data of compiled functions at a time, None without parameters and inputs.

    The arguments are those of functions in Python, of one member.
    """
    parameters: Array | None = arguments[-1] if has_parameters else None
    if not (arguments and isinstance(arguments[0], Reader)):
        return parameters
    numbers = arguments[0].numbers(t)
    return numbers if parameters is None else np.concatenate([parameters, numbers])


def check_inputs(
    inputs: Any, start: float, end: float, members: int | None, table: MethodTable | None,
    name: str = "t",
) -> Inputs | None:  # fmt: skip
    """Return the inputs of an integration, None without any, after checking them.

    Abscissae are checked if there is a ``table``. ``name`` is what messages call the times.
    """
    if inputs is None:
        return None
    in_tuple = isinstance(inputs, tuple)
    curves: Sequence[Any] = inputs if in_tuple else (inputs,)
    if not curves:
        raise ValueError("inputs must hold at least one of cg.Samples, got none")
    for k, curve in enumerate(curves):
        label = f"inputs[{k}]" if in_tuple else "inputs"
        if not isinstance(curve, Samples):
            raise TypeError(f"{label} must be cg.Samples, or a tuple of them, got {curve!r}")
        curve.check_span(start, end, name)
        if curve.members is not None and curve.members != members:
            expected = f"be for {members} members" if members else "be without members=True here"
            raise ValueError(f"{label} must {expected}, got {curve!r}")
    if table is not None:
        check_abscissae(table, "inputs")
    return Inputs(tuple(curves), in_tuple)


def check_abscissae(table: MethodTable, name: str) -> None:
    """Raise ValueError if stages lie outside the step, beyond corners where ``f`` is another."""
    low, high = float(table.c.min()), float(table.c.max())
    if low < -_ABSCISSA_ERROR or high > 1.0 + _ABSCISSA_ERROR:
        raise ValueError(
            f"method must evaluate f within the step with {name}, got {table!r}, whose abscissae "
            f"lie between {low:g} and {high:g}"
        )
