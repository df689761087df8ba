"""Right-hand sides of solutions with their derivatives whose functions are all compiled."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cg.frames.arrays import Array
from cg.frames.base import Frame
from cg.integration.blocks import is_compiled
from cg.integration.compiled_rhs import CompiledRhs
from cg.integration.plan import Plan
from cg.integration.variational.field import DIFFERENCE_STEP, VariationalField
from cg.shared_numbers import VARIATION

__all__ = ["CompiledVariation", "compiled_variation"]

_KINDS: dict[str, Any] = {
    "integer": ctypes.c_int64,
    "real": ctypes.c_double,
    "address": ctypes.c_void_p,
}


class _Record(ctypes.Structure):
    _fields_ = [(name, _KINDS[kind]) for name, kind in VARIATION.items()]


@dataclass(frozen=True)
class CompiledVariation(CompiledRhs):
    """A right-hand side whose functions are called by compiled code.

    Attributes
    ----------
    variational
        The functions.
    plan
        That of the frame alone.
    rows
        Of each member the address of the record, then its parameters, shape ``(members, 1 + k)``.
        Functions are given the address of the parameters, so that events may read them too.
    kept
        What compiled code has the addresses of.
    """

    variational: VariationalField | None = None
    plan: Plan | None = None
    rows: Any = None
    kept: tuple[Any, ...] = field(default=(), compare=False)

    def __reduce__(self) -> tuple[Any, ...]:
        return compiled_variation, (self.variational, self.plan)

    def on(self, frame: Frame, parameters: Array | None) -> CompiledVariation:
        """Return the same right-hand side with the parameters of members."""
        count = 1 if parameters is None else len(parameters)
        width = 0 if parameters is None else parameters.shape[-1]
        rows = np.empty((count, 1 + width))
        rows[:, :1].view(np.int64)[:] = ctypes.addressof(self.kept[0])
        if parameters is not None:
            rows[:, 1:] = parameters
        return replace(self, frame=frame, parameters=parameters, rows=rows)

    @property
    def name(self) -> str:
        """The function that failed last."""
        names: tuple[str, ...] = "f", "jac", "df_dp"
        return names[int(self.kept[0].failed)]

    def addresses(self) -> tuple[int, int, int]:
        """Return addresses of the function and of the first member's data, and their distance."""
        distance = 0 if self.parameters is None else self.rows.strides[0]
        return self.address, self.data_address, distance

    @property
    def data_address(self) -> int:
        """Address of the parameters of the first member."""
        return int(self.rows.ctypes.data) + 8

    def at_member(self, member: int, t: float, y: Any) -> Array:
        """Return the coefficients of a member; RuntimeError if a function returns an error."""
        return self.part(slice(member, member + 1))(t, y)

    def part(self, members: slice) -> CompiledVariation:
        """Return the same for some of the members."""
        if self.parameters is None:
            return self
        return replace(self, parameters=self.parameters[members], rows=self.rows[members])


def compiled_variation(variational: VariationalField, plan: Plan) -> CompiledVariation | None:
    """Return the right-hand side in compiled code, None if a function of it isn't compiled.

    Parameters
    ----------
    variational
        The functions.
    plan
        That of the frame alone.
    """
    import cg._external as core

    f, jac, df_dp = variational.f, variational.jac, variational.df_dp
    functions = [f, *(given for given in (jac, df_dp) if given is not None)]
    if not all(isinstance(function, CompiledRhs) for function in functions):
        return None
    if jac is None and not is_compiled(variational.frame):
        return None  # its flows are Python's
    index, constant = _structure(variational.frame)
    record = _Record(
        **{
            key: value
            for name, function in (("field", f), ("jac", jac), ("df_dp", df_dp))
            if function is not None
            for key, value in ((name, function.address), (f"{name}_data", function.user_data))
        },
        frame=plan.address,
        dimension=variational.frame.dim,
        width=plan.width,
        parameters=variational.count,
        constants=len(constant) - 1,
        index=index.ctypes.data,
        constant=constant.ctypes.data,
        step=DIFFERENCE_STEP,
        nan=np.nan,
    )
    kept = record, index, constant, functions
    return CompiledVariation(
        None, core.variational_field(), 0, variational=variational, plan=plan, kept=kept
    )


def _structure(frame: Frame) -> tuple[Any, Array]:
    """Return the places (i, j, k) of structure constants from one, and the constants.

    A zero follows, since no array may be empty.
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
