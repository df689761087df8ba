"""Compiled right-hand sides of solutions with their derivatives."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from cg.frames.arrays import Array, Points
from cg.integration.loop.messages import DERIVATIVES
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.derivatives import Derivative
from cg.integration.rhs.python import context_of
from cg.integration.step.blocks import is_compiled
from cg.integration.step.plan import Plan
from cg.integration.variational.field import DIFFERENCE_STEP, VariationalField
from cg.integration.variational.noise import Noise
from cg.support.records import fields_of
from cg.support.shared_numbers import VARIATION


class _Record(ctypes.Structure):
    _fields_ = fields_of(VARIATION)


@dataclass(frozen=True, repr=False)
class CompiledVariation(CompiledRhs):
    """A right-hand side of a solution with its derivatives, in compiled code.

    ``fortran/interface/variational.f90`` calls the functions, which may be in Python. They receive
    the address of the parameters, as events do.
    """

    variational: Any = None  # the `VariationalField`
    plan: Any = None  # that of the frame without derivatives
    args: tuple[Any, ...] = ()  # type: ignore[misc]
    # the address of the record of each member, then its parameters, shape (members, 1 + k)
    rows: Any = None
    records: Any = None  # of the members, or one for all
    kept: tuple[Any, ...] = ()  # objects whose addresses are in the records

    def __repr__(self) -> str:
        return f"CompiledVariation({self.variational!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return compiled_variation, (self.variational, self.plan, self.args, self.parameters)

    def with_data(
        self, args: tuple[Any, ...], parameters: Array | None, _: int | None = None
    ) -> CompiledVariation:
        """Return the right-hand side of other members."""
        return compiled_variation(self.variational, self.plan, args, parameters)

    def arguments(self, member: int) -> tuple[Any, ...]:
        """Return the further arguments that events of a member receive."""
        return (*self.args, *super().arguments(member))

    @property
    def failed_name(self) -> str:
        """Name of the function that failed last."""
        names = "f", "jac", "df_dp", DERIVATIVES, "noise"
        return names[max(int(record.failed) for record in self.records)]

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        distance = 0 if self.parameters is None else self.rows.strides[0]
        return self.address, self.data_address, distance

    def at_times(self, times: Array, z: Array) -> Array:
        """Return the coefficients of a single member at points, which are overwritten."""
        import cg._core_r64 as core

        values = np.empty((len(z), self.variational.product.dim))
        address, data, _ = self.addresses()
        for k, t in enumerate(times.tolist()):
            _, code = core.call_field(address, data, 0, t, z[k : k + 1].T, values[k : k + 1].T)
            if code:
                raise RuntimeError(f"{self.failed_name} returned the error code {code} at t = {t}")
        return values

    @property
    def data_address(self) -> int:
        """Address of the parameters of the first member."""
        return int(self.rows.ctypes.data) + 8


def compiled_variation(
    variational: VariationalField, plan: Plan, args: tuple[Any, ...], parameters: Array | None
) -> CompiledVariation:
    """Return the right-hand side for functions of one point.

    The plan is that of the frame without derivatives; ``args`` are further arguments of functions
    in Python.
    """
    import cg._core_r64 as core

    first, *constants = _first_record(variational, plan)
    in_python = []
    for name, function, shape, check in _functions(variational):
        if isinstance(function, CompiledRhs):
            setattr(first, name, function.address)
            setattr(first, f"{name}_data", function.user_data)
        else:
            setattr(first, name, core.function_addresses()[0])
            in_python.append((f"{name}_data", function, shape, check))
    members = 1 if parameters is None else len(parameters)
    rows = np.empty((members, 1 + variational.count))
    if parameters is not None:
        rows[:, 1:] = parameters
    own = parameters is not None and bool(in_python)
    count = members if own else 1
    records = (_Record * count)(*[first] * count)
    contexts = []
    for record, row in zip(records, rows, strict=False):
        arguments = args
        if parameters is not None:
            numbers = row[1:]
            numbers.flags.writeable = False
            arguments = (*args, numbers)
        for name, function, shape, check in in_python:
            contexts.append(context_of(function, arguments, variational.frame, shape, check))
            setattr(record, name, id(contexts[-1]))
    size = ctypes.sizeof(_Record) if own else 0
    rows[:, :1].view(np.int64)[:, 0] = ctypes.addressof(records) + size * np.arange(members)
    return CompiledVariation(
        None, core.function_addresses()[2], 0, frame=variational.product, parameters=parameters,
        variational=variational, plan=plan, args=args, rows=rows, records=records,
        kept=(constants, contexts),
    )  # fmt: skip


def _first_record(variational: VariationalField, plan: Plan) -> tuple[_Record, Any, Array]:
    """Return a record without functions, and its arrays of structure constants."""
    f, (index, constant) = variational.f, variational.structure
    noise = variational.noise
    # arrays can't be empty
    index = np.ascontiguousarray(np.append(index.T, [[0, 0, 0]], axis=0) + 1, dtype=np.intc)
    constant = np.append(constant, 0.0)
    record = _Record(
        frame=plan.address, dimension=variational.frame.dim, width=plan.width,
        parameters=variational.count, constants=len(constant) - 1, index=index.ctypes.data,
        constant=constant.ctypes.data, step=DIFFERENCE_STEP, nan=np.nan,
        data=f.user_data if isinstance(f, CompiledRhs) else 0,
        noises=0 if noise is None else variational.frame.dim,
        noise_data=noise.ctypes.data if isinstance(noise, np.ndarray) else 0,
    )  # fmt: skip
    return record, index, constant


def _functions(variational: VariationalField) -> list[tuple[str, Any, tuple[int, ...], Any]]:
    """Return the functions with their names, the shapes of what they return, and their checks."""
    n, jac = variational.frame.dim, variational.jac
    functions: list[tuple[str, Any, tuple[int, ...], Any]]
    functions = [("f", variational.f, (n,), variational.check)]
    if jac is None and not is_compiled(variational.frame):
        # compiled code takes differences along flows of compiled frames only
        def difference(t: float, y: Points, *arguments: Any) -> Array:
            return variational.differences(t, y, arguments)

        functions.append(("jac", difference, (n, n), lambda value, t, y: value))
    for given in (jac, variational.df_dp, variational.noise):
        if isinstance(given, Derivative):
            function = given.function
            if isinstance(given, Noise) and not isinstance(function, CompiledRhs):
                function = given.checked
            functions.append((given.name, function, given.shape, given.check))
    return functions
