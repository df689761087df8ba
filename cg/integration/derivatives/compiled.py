"""Compiled right-hand sides of solutions with their derivatives."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from cg.integration.derivatives.field import DIFFERENCE_STEP, VariationalField
from cg.integration.derivatives.noise import Noise
from cg.integration.plan.blocks import is_compiled
from cg.integration.plan.plan import Plan
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.given_derivatives import Derivative
from cg.integration.rhs.inputs import (
    DataReader,
    Inputs,
    WithInput,
    arguments_of,
    members_with_data,
)
from cg.integration.rhs.python import context_of
from cg.integration.run.messages import DERIVATIVES
from cg.support.arrays import Array, Points
from cg.support.shared_numbers import FailedFunction
from cg.support.shared_records import VARIATION, fields_of


class _Record(ctypes.Structure):
    _fields_ = fields_of(VARIATION)


@dataclass(frozen=True, repr=False)
class CompiledVariation(CompiledRhs):
    """A right-hand side of a solution with its derivatives, in compiled code.

    ``fortran/interface/variational.f90`` calls the functions, which may be in Python. They receive
    the address of the parameters, as events do. ``data`` has the address of the record of each
    member, then its parameters and inputs.
    """

    variational: Any = None  # the `VariationalField`
    plan: Any = None  # plan of the frame without derivatives
    args: tuple[Any, ...] = ()  # type: ignore[misc]
    records: Any = None  # one for each member, or one for all
    kept: tuple[Any, ...] = ()  # objects whose addresses are in the records

    def __repr__(self) -> str:
        return f"CompiledVariation({self.variational!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        data = self.args, self.parameters, self.inputs
        return compiled_variation, (self.variational, self.plan, *data)

    def with_data(
        self,
        args: tuple[Any, ...],
        parameters: Array | None,
        inputs: Inputs | None,
        _: int | None = None,
    ) -> CompiledVariation:
        """Return the right-hand side of other members."""
        return compiled_variation(self.variational, self.plan, args, parameters, inputs)

    @property
    def failed_name(self) -> str:
        """Name of the function that failed last."""
        failed = FailedFunction(max(record.failed_function for record in self.records))
        return DERIVATIVES if failed is FailedFunction.PRODUCTS else failed.name.lower()

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        distance = self.data.strides[0] if len(self.data) > 1 else 0
        return self.address, self.data_address, distance

    @property
    def data_address(self) -> int:
        """Address of the parameters of the first member."""
        return int(self.data.ctypes.data) + 8


def compiled_variation(
    variational: VariationalField,
    plan: Plan,
    args: tuple[Any, ...],
    parameters: Array | None,
    inputs: Inputs | None,
) -> CompiledVariation:
    """Return the right-hand side for functions of one point.

    The plan is that of the frame without derivatives; ``args`` are further arguments of functions
    in Python.
    """
    import cg._core_r64 as core

    first, *constants = _first_record(variational, plan)
    in_python = _set_functions(first, variational)
    members = members_with_data(inputs, parameters) or 1
    first.inputs = 0 if inputs is None else inputs.width
    own = variational.count - variational.inputs
    scales = np.zeros(own + first.inputs)
    if inputs is not None:
        scales[own:] = inputs.scales
    first.scales = scales.ctypes.data
    rows = np.zeros((members, 1 + own + first.inputs))
    numbers = None if parameters is None else rows[:, 1 : 1 + own]
    if numbers is not None:
        numbers[...] = parameters
        numbers = numbers.view()
        numbers.flags.writeable = False
    count = members if in_python else 1
    records = (_Record * count)(*[first] * count)
    arguments = [arguments_of(inputs, args, numbers, member) for member in range(count)]
    if inputs is not None and variational.inputs and variational.df_dp is None:
        # compiled code changes these numbers for differences
        arguments = [(DataReader(inputs, rows[0, 1 + own :]), *arguments[0][1:])]
    contexts = []
    for record, given in zip(records, arguments, strict=True):
        for name, function, shape, check in in_python:
            frame = variational.frame
            dtype = frame.rhs_dtype if check is variational.check else np.dtype(np.float64)
            contexts.append(context_of(function, given, frame, shape, check, dtype))
            setattr(record, name, id(contexts[-1]))
    size = ctypes.sizeof(_Record) if count > 1 else 0
    rows[:, :1].view(np.int64)[:, 0] = ctypes.addressof(records) + size * np.arange(members)
    return CompiledVariation(
        None, core.function_addresses()[2], 0, frame=variational.product, parameters=parameters,
        inputs=inputs, variational=variational, plan=plan, args=args, data=rows, records=records,
        kept=(constants, contexts, scales),
    )  # fmt: skip


def _first_record(variational: VariationalField, plan: Plan) -> tuple[Any, ...]:
    """Return a record without functions, and the arrays whose addresses are in it."""
    f, (index, constant) = variational.f, variational.structure
    noise = variational.noise
    # arrays can't be empty
    index = np.ascontiguousarray(np.append(index.T, [[0, 0, 0]], axis=0) + 1, dtype=np.intc)
    constant = np.append(constant, 0.0)
    record = _Record(
        frame=plan.address, dimension=variational.frame.dim, width=plan.width,
        parameters=variational.count, constants=len(constant) - 1, index=index.ctypes.data,
        constant=constant.ctypes.data, step=DIFFERENCE_STEP,
        data=f.user_data if isinstance(f, CompiledRhs) else 0,
        kicks=variational.kicks, noises=0 if noise is None else variational.frame.dim,
        noise_data=noise.ctypes.data if isinstance(noise, np.ndarray) else 0,
    )  # fmt: skip
    directions = None
    if (chosen := variational.chosen) is not None:
        # a row each, and never empty
        directions = np.append(chosen[variational.frame.dim :].T.ravel(), 0.0)
        record.directions, record.by_parameters = chosen.shape[1], directions.ctypes.data
    return record, index, constant, directions


def _set_functions(record: _Record, variational: VariationalField) -> list[Any]:
    """Put functions into a record; return those in Python, whose data it lacks yet."""
    import cg._core_r64 as core

    in_python = []
    for name, function, shape, check in _functions(variational):
        if isinstance(function, CompiledRhs):
            setattr(record, name, function.address)
            setattr(record, f"{name}_data", function.user_data)
        else:
            setattr(record, name, core.function_addresses()[0])
            in_python.append((f"{name}_data", function, shape, check))
    return in_python


def _with_copy(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return arguments with parameters that f may keep: differences change them in place."""
    parameters = arguments[-1].copy()
    parameters.flags.writeable = False
    return (*arguments[:-1], parameters)


def _functions(variational: VariationalField) -> list[tuple[str, Any, tuple[int, ...], Any]]:
    """Return the functions with their names, the shapes of what they return, and their checks."""
    frame, jac = variational.frame, variational.jac
    f, shifted = variational.f, variational.df_dp is None and variational.count > variational.inputs
    if shifted and not isinstance(f, CompiledRhs):
        inner = f.function if isinstance(f, WithInput) else f

        def with_copies(t: float, y: Points, *arguments: Any) -> Any:
            return inner(t, y, *_with_copy(arguments))

        f = WithInput(with_copies) if isinstance(f, WithInput) else with_copies
    functions: list[tuple[str, Any, tuple[int, ...], Any]]
    functions = [("f", f, frame.rhs_shape, variational.check)]
    if frame._given is not None and not is_compiled(frame):
        # compiled code has the coefficients of derivatives on compiled frames only
        def coefficients(t: float, y: Points, *arguments: Any) -> Array:
            return variational.coefficients(t, y, _with_copy(arguments) if shifted else arguments)

        functions = [("f", coefficients, (frame.dim,), lambda value, t, y: value)]
    if jac is None and not is_compiled(frame):
        # compiled code takes differences along flows of compiled frames only
        def difference(t: float, y: Points, *arguments: Any) -> Array:
            return variational.differences(t, y, _with_copy(arguments) if shifted else arguments)

        functions.append(("jac", difference, (frame.dim, frame.dim), lambda value, t, y: value))
    for given in (jac, variational.df_dp, variational.noise):
        if isinstance(given, Derivative):
            function = given.function
            if isinstance(given, Noise) and not isinstance(function, CompiledRhs):
                function = given.checked
            functions.append((given.name, function, given.shape, given.check))
    return functions
