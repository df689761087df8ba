"""The equation of a solution and its derivatives, as compiled code evaluates it."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cg.frames.facts import facts_of
from cg.integration.derivatives.noise import Noise
from cg.integration.derivatives.variational_equation import DIFFERENCE_STEP, VariationalEquation
from cg.integration.plan.plan import Plan
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.form import RhsForm, templates_of
from cg.integration.rhs.inputs import DataReader, ExtraArguments
from cg.integration.rhs.python import CALL_PYTHON, CALL_VARIATIONAL, Derivative, call_context
from cg.support.arrays import Array, Points, address_of, read_only
from cg.support.shared_numbers import FailedFunction
from cg.support.shared_records import VARIATION, fields_of

_ONE_SIDED_STEP = float(np.finfo(np.float64).eps) ** (1 / 2)


class VariationRecord(ctypes.Structure):
    """The record of a variational equation in compiled code."""

    _fields_ = fields_of(VARIATION)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class CompiledVariation(CompiledRhs):
    """A right-hand side of a solution with its derivatives, in compiled code.

    ``fortran/runs/variational.f90`` calls the functions, which may be in Python. They receive
    the address of the parameters, as events do. ``data`` has the address of the record of each
    member, then its parameters and inputs.
    """

    equation: VariationalEquation
    plan: Plan  # plan of the frame without derivatives
    records: Any  # an array of ctypes, one for each member, or one for all
    kept: tuple[Any, ...]  # objects whose addresses are in the records

    def __repr__(self) -> str:
        return f"CompiledVariation({self.equation!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return compiled_variation, (self.equation, self.plan, self.extra)

    def with_data(self, extra: ExtraArguments) -> CompiledVariation:
        """Return the right-hand side of other members."""
        return compiled_variation(self.equation, self.plan, extra)

    @property
    def writes_results(self) -> bool:  # type: ignore[override]
        """Whether functions of the user write their results."""
        return isinstance(self.equation.f, CompiledRhs)

    def failed_name(self, member: int) -> str | None:
        """Return the name of the function that failed last, None for products with derivatives."""
        record = self.records[member if len(self.records) > 1 else 0]
        failed = FailedFunction(record.failed_function)
        return None if failed is FailedFunction.PRODUCTS else failed.name.lower()

    @property
    def data_address(self) -> int:
        """Address of the parameters of the first member."""
        return address_of(self.data) + 8


def compiled_variation(
    equation: VariationalEquation, plan: Plan, extra: ExtraArguments
) -> CompiledVariation:
    """Return the right-hand side for functions of one point.

    The plan is that of the frame without derivatives.
    """
    shared_record, in_python, arrays = _shared_entries(equation, plan)
    inputs, members = extra.inputs, extra.members or 1
    shared_record.inputs = 0 if inputs is None else inputs.width
    plain_count = equation.parameter_count - equation.input_count
    scales = np.zeros(plain_count + shared_record.inputs)
    if inputs is not None:
        scales[plain_count:] = inputs.scales
    shared_record.scales = address_of(scales)
    rows = np.zeros((members, 1 + plain_count + shared_record.inputs))
    parameters, values = rows[:, 1 : 1 + plain_count], rows[0, 1 + plain_count :]
    count = members if in_python else 1
    records = (VariationRecord * count)(*[shared_record] * count)
    call_arguments = extra  # with the parameters that compiled code changes for differences
    if extra.parameters is not None:
        parameters[...] = extra.parameters
        call_arguments = extra._replace(parameters=read_only(parameters))
    contexts = _add_contexts(records, equation, in_python, call_arguments, values)
    size = ctypes.sizeof(VariationRecord) if count > 1 else 0
    rows[:, :1].view(np.int64)[:, 0] = ctypes.addressof(records) + size * np.arange(members)
    return CompiledVariation(
        None, CALL_VARIATIONAL, 0, form=RhsForm(equation.product), extra=extra, data=rows,
        equation=equation, plan=plan, records=records, kept=(arrays, contexts, scales),
    )  # fmt: skip


def _add_contexts(
    records: Any, equation: VariationalEquation, in_python: list[_Function],
    extra: ExtraArguments, values: Array,
) -> list[Any]:  # fmt: skip
    """Put the contexts of functions in Python into records; return them to keep them alive."""
    arguments = [extra.arguments(member) for member in range(len(records))]
    if extra.inputs is not None and equation.input_count and equation.df_dp is None:
        # compiled code changes the values for differences
        arguments = [(DataReader(extra.inputs, values), *arguments[0][1:])]
    # differences change parameters in place
    changing = equation.df_dp is None and equation.parameter_count > equation.input_count
    contexts = []
    for record, own in zip(records, arguments, strict=True):
        for name, function, shape, check in in_python:
            frame = equation.product if name == "along" else equation.frame
            dtype = equation.form.dtype if check is equation.check else np.float64
            templates = templates_of(frame, shape, dtype)
            context = call_context(function, own, templates, check, changing)
            pointer = ctypes.c_void_p(id(context))
            contexts.append((context, pointer))
            setattr(record, f"{name}_data", ctypes.addressof(pointer))
    return contexts


class _Function(NamedTuple):
    """A function of a variational equation."""

    name: str  # its entry in the record
    function: Any
    shape: tuple[int, ...]  # shape of a value
    check: Any  # check(value, t, y) returns the value as an array


class _SharedEntries(NamedTuple):
    """The entries that the records of all members share."""

    record: VariationRecord  # lacks the data of functions in Python, which differ between members
    in_python: list[_Function]
    arrays: tuple[Any, ...]  # arrays that the record points to


def _shared_entries(equation: VariationalEquation, plan: Plan) -> _SharedEntries:
    """Return the entries of records that don't depend on parameters and inputs."""
    f, noise, structure = equation.f, equation.noise, equation.structure
    index, constant = structure.addresses
    record = VariationRecord(
        frame=plan.address, dimension=equation.frame.dim, width=plan.width,
        parameters=equation.parameter_count, constants=len(structure.constants),
        index=index, constant=constant, one_sided=equation.one_sided,
        step=_ONE_SIDED_STEP if equation.one_sided else DIFFERENCE_STEP,
        data=f.user_address if isinstance(f, CompiledRhs) else 0,
        forces_alone=equation.forces_alone, noises=0 if noise is None else equation.frame.dim,
        noise_data=noise.ctypes.data if isinstance(noise, np.ndarray) else 0,
    )  # fmt: skip
    parameter_parts = None
    if (matrix := equation.directions) is not None:
        # a row for each direction; arrays can't be empty
        parameter_parts = np.append(matrix[equation.frame.dim :].T.ravel(), 0.0)
        record.directions, record.by_parameters = matrix.shape[1], address_of(parameter_parts)
    in_python = []
    for each in _functions(equation):
        if isinstance(each.function, CompiledRhs):
            setattr(record, each.name, each.function.address)
            setattr(record, f"{each.name}_data", each.function.user_address)
        else:
            setattr(record, each.name, CALL_PYTHON)
            in_python.append(each)
    return _SharedEntries(record, in_python, (structure, parameter_parts))


def _functions(equation: VariationalEquation) -> list[_Function]:
    """Return the functions that compiled code calls."""
    frame, jac = equation.frame, equation.jac
    functions = [_Function("f", equation.f, equation.form.shape, equation.check)]
    if equation.form.derivatives and not facts_of(frame).compiled:
        # compiled code has the coefficients of derivatives on compiled frames only
        def coefficients(t: float, y: Points, *arguments: Any) -> Array:
            return equation.coefficients(t, y, arguments)

        functions = [_Function("f", coefficients, (frame.dim,), _unchecked)]
    if jac is None and not facts_of(frame).compiled:
        # compiled code takes differences along flows of compiled frames only
        def difference(t: float, y: Points, *arguments: Any) -> Array:
            return equation.differences(t, y, arguments)

        function = _Function("jac", difference, (frame.dim, frame.dim), _unchecked)
        if equation.directions is not None:
            shape = frame.dim, equation.direction_count
            function = _Function("along", equation.differences_along, shape, _unchecked)
        functions.append(function)
    for derivative in (jac, equation.df_dp, equation.noise):
        if isinstance(derivative, Derivative):
            f = derivative.function
            if isinstance(derivative, Noise) and not isinstance(f, CompiledRhs):
                f = derivative.checked
            functions.append(_Function(derivative.name, f, derivative.shape, derivative.check))
    return functions


def _unchecked(value: Any, t: float, y: Points) -> Any:
    """Return a value of a function of this module as it is."""
    return value
