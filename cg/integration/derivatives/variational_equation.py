"""Right-hand sides of a solution and its derivatives together, in Python and compiled."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.euclidean import Euclidean
from cg.frames.facts import facts_of
from cg.frames.product import Product
from cg.integration.derivatives.noise import Noise
from cg.integration.errors import DERIVATIVES
from cg.integration.plan.plan import Plan
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.inputs import DataReader, ExtraArguments, Reader, address, data_at
from cg.integration.rhs.python import Check, Derivative, Rhs, call_context, read_only, when
from cg.support.arrays import Array, Points, check_finite
from cg.support.caches import cached_by_value
from cg.support.shared_numbers import FailedFunction
from cg.support.shared_records import VARIATION, fields_of

_VANISHING = float(np.sqrt(np.finfo(np.float64).tiny))
DIFFERENCE_STEP = float(np.finfo(np.float64).eps) ** (1 / 3)
"""Step of central differences, relative to the sizes of coordinates and of parameters."""


@dataclass(frozen=True, eq=False)
class VariationalEquation:
    r"""The coefficients of a solution and of its derivatives: a right-hand side on a product.

    A point is :math:`(y, X)` with :math:`X = (\Phi, S, C)`, shape ``(dim, columns)`` in C order.
    With chosen directions, the columns of :math:`(D, P)` in initial coordinates and parameters, X
    has one column for each and starts as D.
    The derivative of :math:`y` with respect to anything has coordinates :math:`\xi` in the frame,
    :math:`\partial y = \sum_i \xi_i E_i(y)`, and from :math:`y' = \sum_i f_i E_i(y)` follows

    .. math:: \xi' = \frac{\partial f}{\partial y} \xi + [f, \xi] + \frac{\partial f}{\partial p} ,

    with the bracket of `Frame.bracket`, whose sign is that of the frame's convention. Noise with
    the spectral density Q has the covariance C, with :math:`C' = A C + C A^T + Q` where
    :math:`A \xi` are the first two terms; without noise there is no C.
    """

    frame: Frame
    f: Any  # a `CompiledRhs` if it is compiled
    jac: Derivative | None
    df_dp: Derivative | None
    parameter_count: int  # with inputs if there are derivatives with respect to them
    vectorized: bool = False  # whether the functions take points of several members in one call
    input_count: int = 0  # number of the parameters that are values of inputs
    noise: Derivative | Array | None = None  # spectral density of noise
    chosen: Array | None = None  # directions in initial coordinates and parameters, columns
    # whether forces alone make the coefficients, as a splitting method takes them: the tangents of
    # drifts are in fortran/frames/gyroscopic.f90
    forces_alone: bool = False

    @property
    def direction_count(self) -> int:
        """Number of columns that are derivatives of the solution."""
        chosen = self.chosen
        return self.frame.dim + self.parameter_count if chosen is None else chosen.shape[1]

    @property
    def column_count(self) -> int:
        """Number of all columns, with those of the covariance of noise."""
        return self.direction_count + (0 if self.noise is None else self.frame.dim)

    @property
    def has_point_directions(self) -> bool:
        """Whether the chosen directions are those of all initial coordinates."""
        n, chosen = self.frame.dim, self.chosen
        return chosen is not None and np.array_equal(chosen, np.eye(n + self.parameter_count, n))

    def along_directions(self, derivatives: Array) -> Array:
        """Return derivatives with respect to parameters along the directions.

        The shape is ``(..., directions)``, of derivatives with respect to all parameters
        ``(..., k)``.
        """
        if self.chosen is not None:
            return derivatives @ self.chosen[self.frame.dim :]
        none = np.zeros((*derivatives.shape[:-1], self.frame.dim))
        return np.concatenate([none, derivatives], axis=-1)

    def __post_init__(self) -> None:
        vars(self).update(
            product=_product(self.frame, self.column_count),
            structure=_NO_CONSTANTS if self.forces_alone else structure_of(self.frame),
            check=Check(self.f, self.frame, self.vectorized),
        )

    product: Product = field(init=False)  # the frame of points with derivatives
    structure: Structure = field(init=False, repr=False)
    check: Check = field(init=False, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        return VariationalEquation, tuple(getattr(self, x.name) for x in fields(self) if x.init)

    def start(self, y: Points) -> Array:
        """Return initial points with their derivatives, shape ``(members, *product shape)``."""
        n, chosen = self.frame.dim, self.chosen
        numbers = np.ascontiguousarray(y).reshape(len(y), -1).view(np.float64)
        z = np.empty((len(y), *self.product.point_shape))
        z[:, : numbers.shape[1]] = numbers
        x = np.eye(n, self.column_count) if chosen is None else chosen[:n]
        z[:, numbers.shape[1] :] = x.ravel()
        return z

    def split(self, z: Array) -> tuple[Points, Array]:
        """Return points and their derivatives, shape ``(..., dim, columns)``."""
        y, x = self.product._split(z)
        return y, x.reshape(*x.shape[:-1], self.frame.dim, self.column_count)

    def __call__(self, t: Array, z: Array, *arguments: Any) -> Array:
        """Return the coefficients of several members: those of ``f``, then the derivatives of X.

        They are NaN, which ends steps, at points that aren't finite, and where f isn't. For
        functions of one point ``fortran/runs/variational.f90`` evaluates them.
        """
        finite = np.isfinite(z).all(axis=-1)
        if not finite.all():
            return self._where(finite, t, z, arguments)
        y, x = self.split(z)
        coefficients = self.coefficients(t, y, arguments)
        finite = np.isfinite(coefficients).all(axis=-1)
        if not finite.all():
            return self._where(finite, t, z, arguments)
        (i, j, k), constants = self.structure.index, self.structure.constants
        with np.errstate(over="ignore", invalid="ignore"):
            jac = self.differences if self.jac is None else self.jac
            matrix = np.array(jac(t, y, arguments))
            entries: Any = slice(None), k, j
            np.add.at(matrix, entries, constants * coefficients[:, i])
            slope, m = matrix @ x, self.direction_count
            if self.parameter_count:
                df_dp = self._differences_by_parameters if self.df_dp is None else self.df_dp
                slope[..., :m] += self.along_directions(df_dp(t, y, arguments))
            if (noise := self.noise) is not None:
                density = noise(t, y, arguments) if isinstance(noise, Derivative) else noise
                slope[..., m:] += x[..., m:] @ matrix.mT + density
        if not np.isfinite(slope[np.isfinite(matrix).all(axis=(-2, -1))]).all():
            raise OverflowError(
                f"derivatives of the solution exceed the range of floating point at {when(t)}"
            )
        return np.concatenate([coefficients, slope.reshape(len(z), -1)], axis=-1)

    def _where(self, finite: Any, t: Array, z: Array, arguments: tuple[Any, ...]) -> Array:
        """Return the coefficients of the members that are finite, and NaN for the others."""
        values = np.full((len(z), self.product.dim), np.nan)
        if finite.any():
            if self.parameter_count:
                arguments = (*arguments[:-1], arguments[-1][finite])
            if arguments and isinstance(arguments[0], Reader):
                arguments = (arguments[0][finite], *arguments[1:])
            values[finite] = self(t[finite], z[finite], *arguments)
        return values

    def coefficients(
        self, t: Any, y: Points, arguments: tuple[Any, ...], whole: bool = False
    ) -> Array:
        """Return the coefficients at a point, or at points of several members.

        Where forces alone make them, free motion is left out unless the ``whole`` is asked for.
        """
        if isinstance(self.f, CompiledRhs):
            row: Array = self._at_points(t, y[None], arguments, whole)[0]
            return row
        return self._complete(self.check(self.f(t, read_only(y), *arguments), t), y, whole)

    def _complete(self, values: Array, y: Points, whole: bool) -> Array:
        complete = self.frame.complete_rhs(values, y)
        if self.forces_alone and not whole:
            frame: Any = self.frame
            complete[..., : frame.rhs_dim] = 0.0
            complete[..., frame.rhs_dim :] = frame.tangential(y, values)
        return complete

    def differences(self, t: Any, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return differences of ``f`` along the frame's fields, shape ``(..., n, n)``."""
        n, shape = self.frame.dim, self.frame.point_shape
        lead = y.shape[: y.ndim - len(shape)]
        sizes = DIFFERENCE_STEP * np.maximum(self.frame.coordinate_sizes(y), 1.0)
        v = sizes[..., None, :] * np.concatenate([np.eye(n), -np.eye(n)])
        start = np.broadcast_to(y.reshape(*lead, 1, *shape), (*lead, 2 * n, *shape))
        values = self._at_points(t, self.frame.flow(v, start), arguments)
        differences: Array = values[..., :n, :] - values[..., n:, :]
        return np.ascontiguousarray(differences.mT / (2.0 * sizes[..., None, :]))

    def differences_along(self, t: Any, z: Array, *arguments: Any) -> Array:
        """Return differences of ``f`` along the directions, shape ``(dim, directions)``.

        They are taken as compiled code takes them on its frames, see `add_differences` in
        ``fortran/runs/variational.f90``.
        """
        y, x = self.split(z)
        shifts, numbers = np.zeros((x.shape[1], 0)), np.zeros(0)
        if self.df_dp is None and self.chosen is not None and self.parameter_count:
            shifts, numbers = self.chosen[len(x) :].T, arguments[-1]
        sizes, scales = np.maximum(self.frame.coordinate_sizes(y), 1.0), np.abs(numbers)
        scales[scales <= _VANISHING] = 1.0

        def at(point: Points, shift: Array) -> Array:
            shifted = (*arguments[:-1], numbers + shift) if shift.size else arguments
            return self.coefficients(t, point, shifted)

        slopes = np.zeros_like(x)
        for j, (v, shift) in enumerate(zip(x.T, shifts, strict=True)):
            lengths = np.abs(v / sizes).max(), np.abs(shift / scales).max(initial=0.0)
            changes = [(lengths[0], v, 0.0 * shift), (lengths[1], 0.0 * v, shift)]
            if min(lengths) * 1000.0 > max(lengths):
                changes = [(max(lengths), v, shift)]
            for length, along, change in changes:
                if length > 0.0:
                    step = DIFFERENCE_STEP / length
                    ends = self.frame.flow([step * along, -step * along], np.stack([y, y]))
                    difference = at(ends[0], step * change) - at(ends[1], -step * change)
                    slopes[:, j] += difference / (2.0 * step)
        return slopes

    def _at_points(
        self, t: Any, points: Points, arguments: tuple[Any, ...], whole: bool = False
    ) -> Array:
        """Return coefficients at several points of each member, shape ``(..., points, n)``."""
        if isinstance(self.f, CompiledRhs):
            data = data_at(t, arguments, self.parameter_count > 0)
            address = self.f.user_data if data is None else data.ctypes.data
            values = self.f.values(self.frame, address, t, points)
            return self._complete(values, points, whole)
        if not self.vectorized:
            return np.array([self.coefficients(t, point, arguments) for point in points])
        count = points.shape[1]
        flat = points.reshape(-1, *self.frame.point_shape)
        if self.parameter_count:
            arguments = (*arguments[:-1], np.repeat(arguments[-1], count, axis=0))
        values = self.coefficients(np.repeat(t, count), flat, arguments)
        return values.reshape(len(points), count, -1)

    def _differences_by_parameters(self, t: Array, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return differences of ``f`` by the parameters, shape ``(members, n, k)``."""
        *others, rows = arguments
        return parameter_differences(lambda x: self.coefficients(t, y, (*others, x)), rows)


def parameter_steps(row: Array, step: float, scales: Any = 0.0) -> list[tuple[Array, Array]]:
    """Return for each parameter a step of it, as a change of all of them, and its size.

    Parameters have the shape ``(..., k)``. ``step`` is relative to the parameter or its scale, or
    to one if the square of both vanishes.
    """
    sizes = np.maximum(np.abs(row), scales)
    sizes = step * np.where(sizes > _VANISHING, sizes, 1.0)
    return [(sizes * unit, sizes[..., i]) for i, unit in enumerate(np.eye(row.shape[-1]))]


def parameter_differences(
    function: Callable[[Array], Array], row: Array, scales: Any = 0.0
) -> Array:
    """Return central differences of ``function(row)`` by each parameter, on a last axis."""
    columns = []
    for change, size in parameter_steps(row, DIFFERENCE_STEP, scales):
        ahead, behind = function(row + change), function(row - change)
        columns.append((ahead - behind) / (2.0 * size[..., None]))
    return np.stack(columns, axis=-1)


def count_parameters(rhs: Rhs, df_dp: Any, by_inputs: bool) -> tuple[int, int]:
    """Return how many numbers derivatives are with respect to, and how many of inputs.

    ValueError is raised if parameters aren't finite, or there are none for ``df_dp``.
    """
    numbers, inputs = rhs.extra.parameters, rhs.extra.inputs
    width = inputs.width if by_inputs and inputs is not None else 0
    if df_dp is not None and numbers is None and not width:
        raise ValueError(f"parameters must be given with df_dp = {df_dp!r}, got None")
    if numbers is None:
        return width, width
    check_finite("parameters", numbers if len(numbers) > 1 else numbers[0])
    return numbers.shape[-1] + width, width


def _product(frame: Frame, columns: int) -> Product:
    """Return the frame of points with columns of derivatives, which is kept."""
    products, key = facts_of(frame).products, (columns, id(frame._user_frame))
    if key not in products:
        products[key] = Product(frame, Euclidean(frame.dim * columns))
    product: Product = products[key]
    return product


class Structure:
    """The structure constants of the fields that aren't zero.

    ``index`` holds i, j, k, shape ``(3, constants)``, and ``constants`` the parts of [E_i, E_j]
    along E_k. ``addresses`` are those of both as compiled code reads them.
    """

    def __init__(self, index: NDArray[np.intp], constants: Array) -> None:
        self.index, self.constants = index, constants
        # numbers count from 1; arrays can't be empty
        rows = np.ascontiguousarray(np.append(index.T, [[0, 0, 0]], axis=0) + 1, dtype=np.intc)
        self._kept = rows, np.append(constants, 0.0)
        self.addresses = self._kept[0].ctypes.data, self._kept[1].ctypes.data


_NO_CONSTANTS = Structure(np.zeros((3, 0), dtype=np.intp), np.zeros(0))


@cached_by_value
def structure_of(frame: Frame) -> Structure:
    """Return the structure constants of a frame, which are kept."""
    basis = np.eye(frame.dim)
    rows, values = [np.zeros((3, 0), dtype=np.intp)], [np.zeros(0)]
    for i, e in enumerate(basis):
        brackets = frame.bracket(e, basis)
        j, k = np.nonzero(np.abs(brackets) > 1e-14 * np.abs(brackets).max(initial=0.0))
        rows.append(np.stack([np.full_like(j, i), j, k]))
        values.append(brackets[j, k])
    return Structure(np.concatenate(rows, axis=1), np.concatenate(values))


class _Record(ctypes.Structure):
    _fields_ = fields_of(VARIATION)


@dataclass(frozen=True, repr=False)
class CompiledVariation(CompiledRhs):
    """A right-hand side of a solution with its derivatives, in compiled code.

    ``fortran/runs/variational.f90`` calls the functions, which may be in Python. They receive
    the address of the parameters, as events do. ``data`` has the address of the record of each
    member, then its parameters and inputs.
    """

    variational: Any = None  # the `VariationalEquation`
    plan: Any = None  # plan of the frame without derivatives
    records: Any = None  # one for each member, or one for all
    kept: tuple[Any, ...] = ()  # objects whose addresses are in the records

    def __repr__(self) -> str:
        return f"CompiledVariation({self.variational!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return compiled_variation, (self.variational, self.plan, self.extra)

    def with_data(self, extra: ExtraArguments) -> CompiledVariation:
        """Return the right-hand side of other members."""
        return compiled_variation(self.variational, self.plan, extra)

    @property
    def written(self) -> bool:  # type: ignore[override]
        """Whether functions of the user write their results."""
        return isinstance(self.variational.f, CompiledRhs)

    def failed_name(self, member: int) -> str:
        """Return the name of the function that failed last, of a member."""
        record = self.records[member if len(self.records) > 1 else 0]
        failed = FailedFunction(record.failed_function)
        return DERIVATIVES if failed is FailedFunction.PRODUCTS else failed.name.lower()

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        distance = self.data.strides[0] if len(self.data) > 1 else 0
        return self.address, self.data_address, distance

    @property
    def data_address(self) -> int:
        """Address of the parameters of the first member."""
        return address(self.data) + 8


def compiled_variation(
    variational: VariationalEquation, plan: Plan, extra: ExtraArguments
) -> CompiledVariation:
    """Return the right-hand side for functions of one point.

    The plan is that of the frame without derivatives.
    """
    import cg._core_r64 as core

    first, in_python, arrays = _shared_entries(variational, plan)
    inputs, members = extra.inputs, extra.members or 1
    first.inputs = 0 if inputs is None else inputs.width
    plain_count = variational.parameter_count - variational.input_count
    scales = np.zeros(plain_count + first.inputs)
    if inputs is not None:
        scales[plain_count:] = inputs.scales
    first.scales = address(scales)
    rows = np.zeros((members, 1 + plain_count + first.inputs))
    parameters, values = rows[:, 1 : 1 + plain_count], rows[0, 1 + plain_count :]
    count = members if in_python else 1
    records = (_Record * count)(*[first] * count)
    shared = extra  # with the parameters that compiled code changes for differences
    if extra.parameters is not None:
        parameters[...] = extra.parameters
        parameters.flags.writeable = False
        shared = extra._replace(parameters=parameters)
    contexts = _add_contexts(records, variational, in_python, shared, values)
    size = ctypes.sizeof(_Record) if count > 1 else 0
    rows[:, :1].view(np.int64)[:, 0] = ctypes.addressof(records) + size * np.arange(members)
    return CompiledVariation(
        None, core.function_addresses()[1], 0, frame=variational.product, extra=extra, data=rows,
        variational=variational, plan=plan, records=records, kept=(arrays, contexts, scales),
    )  # fmt: skip


def _add_contexts(
    records: Any, variational: VariationalEquation, in_python: list[_Function],
    extra: ExtraArguments, values: Array,
) -> list[Any]:  # fmt: skip
    """Put data of functions in Python into records, and return it."""
    arguments = [extra.arguments(member) for member in range(len(records))]
    if extra.inputs is not None and variational.input_count and variational.df_dp is None:
        # compiled code changes the values for differences
        arguments = [(DataReader(extra.inputs, values), *arguments[0][1:])]
    # differences change parameters in place
    changing = variational.df_dp is None and variational.parameter_count > variational.input_count
    contexts = []
    for record, rest in zip(records, arguments, strict=True):
        for name, function, shape, check in in_python:
            frame = variational.product if name == "along" else variational.frame
            dtype = frame.rhs_dtype if check is variational.check else np.dtype(np.float64)
            context = call_context(function, rest, frame, shape, check, dtype, changing)
            place = ctypes.c_void_p(id(context))
            contexts.append((context, place))
            setattr(record, f"{name}_data", ctypes.addressof(place))
    return contexts


class _Function(NamedTuple):
    """A function of a variational equation."""

    name: str  # its entry in the record
    function: Any
    shape: tuple[int, ...]  # that of its values
    check: Any  # check(value, t, y) returns the value as an array


class _SharedEntries(NamedTuple):
    """The entries that the records of all members share."""

    record: _Record  # lacks the data of functions in Python, which differ between members
    in_python: list[_Function]
    arrays: tuple[Any, ...]  # those whose addresses are in the record


def _shared_entries(variational: VariationalEquation, plan: Plan) -> _SharedEntries:
    """Return the entries of records that don't depend on parameters and inputs."""
    import cg._core_r64 as core

    f, noise, structure = variational.f, variational.noise, variational.structure
    index, constant = structure.addresses
    record = _Record(
        frame=plan.address, dimension=variational.frame.dim, width=plan.width,
        parameters=variational.parameter_count, constants=len(structure.constants),
        index=index, constant=constant, step=DIFFERENCE_STEP,
        data=f.user_data if isinstance(f, CompiledRhs) else 0,
        forces_alone=variational.forces_alone, noises=0 if noise is None else variational.frame.dim,
        noise_data=noise.ctypes.data if isinstance(noise, np.ndarray) else 0,
    )  # fmt: skip
    directions = None
    if (chosen := variational.chosen) is not None:
        # a row for each direction; arrays can't be empty
        directions = np.append(chosen[variational.frame.dim :].T.ravel(), 0.0)
        record.directions, record.by_parameters = chosen.shape[1], address(directions)
    in_python = []
    caller = core.function_addresses()[0]
    for each in _functions(variational):
        if isinstance(each.function, CompiledRhs):
            setattr(record, each.name, each.function.address)
            setattr(record, f"{each.name}_data", each.function.user_data)
        else:
            setattr(record, each.name, caller)
            in_python.append(each)
    return _SharedEntries(record, in_python, (structure, directions))


def _functions(variational: VariationalEquation) -> list[_Function]:
    """Return the functions that compiled code calls."""
    frame, jac = variational.frame, variational.jac
    functions = [_Function("f", variational.f, frame.rhs_shape, variational.check)]
    if frame._user_frame is not None and not facts_of(frame).compiled:
        # compiled code has the coefficients of derivatives on compiled frames only
        def coefficients(t: float, y: Points, *arguments: Any) -> Array:
            return variational.coefficients(t, y, arguments)

        functions = [_Function("f", coefficients, (frame.dim,), _unchecked)]
    if jac is None and not facts_of(frame).compiled:
        # compiled code takes differences along flows of compiled frames only
        def difference(t: float, y: Points, *arguments: Any) -> Array:
            return variational.differences(t, y, arguments)

        function = _Function("jac", difference, (frame.dim, frame.dim), _unchecked)
        if variational.chosen is not None:
            shape = frame.dim, variational.direction_count
            function = _Function("along", variational.differences_along, shape, _unchecked)
        functions.append(function)
    for derivative in (jac, variational.df_dp, variational.noise):
        if isinstance(derivative, Derivative):
            f = derivative.function
            if isinstance(derivative, Noise) and not isinstance(f, CompiledRhs):
                f = derivative.checked
            functions.append(_Function(derivative.name, f, derivative.shape, derivative.check))
    return functions


def _unchecked(value: Any, t: float, y: Points) -> Any:
    """Return a value of a function of this module as it is."""
    return value
