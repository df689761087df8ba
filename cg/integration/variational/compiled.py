"""Compiled right-hand sides of solutions with their derivatives."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cg.frames.arrays import Array
from cg.frames.base import Frame
from cg.integration.loop.messages import DERIVATIVES
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.step.blocks import is_compiled
from cg.integration.step.plan import Plan
from cg.integration.variational.field import DIFFERENCE_STEP, VariationalField
from cg.support.shared_numbers import VARIATION

_KINDS: dict[str, Any] = {
    "integer": ctypes.c_int64,
    "real": ctypes.c_double,
    "address": ctypes.c_void_p,
}


class _Record(ctypes.Structure):
    _fields_ = [(name, _KINDS[kind]) for name, kind in VARIATION.items()]


@dataclass(frozen=True, repr=False)
class CompiledVariation(CompiledRhs):
    """A right-hand side of a solution with its derivatives, in compiled code.

    The functions may be in Python; `fortran/interface/variational.f90` calls them.

    Attributes
    ----------
    variational
        The functions.
    plan
        The plan of the frame without derivatives.
    args
        Further arguments of functions in Python.
    rows
        The address of the record of each member, then its parameters, shape ``(members, 1 + k)``.
        Functions receive the address of the parameters, so that events may read them too.
    records
        The records of the members, or one for all.
    kept
        Objects whose addresses are in the records.
    """

    variational: VariationalField | None = None
    plan: Plan | None = None
    args: tuple[Any, ...] = ()
    rows: Any = None
    records: Any = None
    kept: tuple[Any, ...] = field(default=(), compare=False)

    has_args = True

    def __repr__(self) -> str:
        return f"CompiledVariation({self.variational!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return compiled_variation, (self.variational, self.plan, self.args)

    def on(self, frame: Frame, parameters: Array | None) -> CompiledVariation:
        """Return the same right-hand side with the parameters of members."""
        variational = self.variational
        assert variational is not None
        members = 1 if parameters is None else len(parameters)
        rows = np.empty((members, 1 + variational.count))
        if parameters is not None:
            rows[:, 1:] = parameters
        in_python = [
            (f"{name}_data", function, variational.check_of(name), shape)
            for name, function, shape in variational.functions()
            if function is not None and not isinstance(function, CompiledRhs)
        ]
        own = parameters is not None and bool(in_python)
        records = (_Record * (members if own else 1))(*[self.records[0]] * (members if own else 1))
        contexts = []
        for record, row in zip(records, rows, strict=False):
            arguments = self.args
            if parameters is not None:
                numbers = row[1:]
                numbers.flags.writeable = False
                arguments = (*arguments, numbers)
            point = variational.frame.point_shape, variational.frame.dtype.num
            for name, function, check, shape in in_python:
                contexts.append((function, arguments, *point, shape, check, [None]))
                setattr(record, name, id(contexts[-1]))
        first, size = ctypes.addressof(records), ctypes.sizeof(_Record) if own else 0
        rows[:, :1].view(np.int64)[:, 0] = first + size * np.arange(members)
        kept = *self.kept, contexts
        return replace(
            self, frame=frame, parameters=parameters, rows=rows, records=records, kept=kept
        )

    @property
    def name(self) -> str:
        """Name of the function that failed last."""
        names: tuple[str, ...] = "f", "jac", "df_dp", DERIVATIVES
        return names[max(int(record.failed) for record in self.records)]

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        distance = 0 if self.parameters is None else self.rows.strides[0]
        return self.address, self.data_address, distance

    @property
    def data_address(self) -> int:
        """Address of the parameters of the first member."""
        return int(self.rows.ctypes.data) + 8

    def answer(self, member: int, t: float, y: Any) -> Array:
        """Return the coefficients of a member; RuntimeError if a function returns an error."""
        return self.part(slice(member, member + 1))(t, y)

    def part(self, members: slice) -> CompiledVariation:
        """Return the right-hand side of some of the members."""
        if self.parameters is None:
            return self
        return replace(self, parameters=self.parameters[members], rows=self.rows[members])


def compiled_variation(
    variational: VariationalField, plan: Plan, args: tuple[Any, ...] = ()
) -> CompiledVariation | None:
    """Return the right-hand side in compiled code, or None.

    It is None for vectorized functions, and for differences on frames that aren't compiled.  The
    plan is that of the frame without derivatives; ``args`` are further arguments of functions in
    Python.
    """
    import cg._core_r64 as core

    if variational.vectorized or (variational.jac is None and not is_compiled(variational.frame)):
        return None
    index, constant = _structure(variational.frame)
    record = _Record(
        frame=plan.address,
        dimension=variational.frame.dim,
        width=plan.width,
        parameters=variational.count,
        constants=len(constant) - 1,
        index=index.ctypes.data,
        constant=constant.ctypes.data,
        step=DIFFERENCE_STEP,
        nan=np.nan,
        data=variational.f.user_data if isinstance(variational.f, CompiledRhs) else 0,
    )
    for name, function, _ in variational.functions():
        if isinstance(function, CompiledRhs):
            setattr(record, name, function.address)
            setattr(record, f"{name}_data", function.user_data)
        elif function is not None:
            setattr(record, name, core.function_addresses()[0])
    return CompiledVariation(
        None, core.function_addresses()[2], 0, variational=variational, plan=plan, args=args,
        records=[record], kept=(index, constant),
    )  # fmt: skip


def _structure(frame: Frame) -> tuple[Any, Array]:
    """Return the indices (i, j, k) of structure constants, from one, and the constants.

    The last entry is zero, since no array may be empty.
    """
    basis = np.eye(frame.dim)
    rows, values = [np.zeros((0, 3), dtype=np.intp)], [np.zeros(0)]
    for i, e in enumerate(basis):
        brackets = frame.bracket(e, basis)
        j, k = np.nonzero(np.abs(brackets) > 1e-14 * np.abs(brackets).max(initial=0.0))
        rows.append(np.stack([np.full_like(j, i), j, k], axis=-1))
        values.append(brackets[j, k])
    index = np.concatenate([*rows, np.zeros((1, 3), dtype=np.intp)]) + 1
    return np.ascontiguousarray(index, dtype=np.intc), np.append(np.concatenate(values), 0.0)
