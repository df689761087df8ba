"""Right-hand sides that are compiled: C functions, SciPy's LowLevelCallable, numba's cfunc."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from types import FunctionType
from typing import Any, ClassVar

import numpy as np
from scipy import LowLevelCallable

from cg import _core_r64 as core
from cg.integration.rhs.form import RhsForm
from cg.integration.rhs.function import CompiledFunction, TimeFunction
from cg.integration.rhs.inputs import NO_EXTRA, ExtraArguments
from cg.support.arrays import Array, Points, address_of
from cg.support.capsules import address_in, data_in
from cg.support.frozen import changed

SIGNATURE = "int (double, double *, double *, void *)"
"""The type of compiled right-hand sides in C; ``const`` may stand anywhere."""

EVENT_SIGNATURE = "double (double, double *, void *)"
"""The type of compiled events in C; ``const`` may stand anywhere."""

_FUNCTION_POINTER: Any = ctypes.CFUNCTYPE(None).__mro__[1]


@dataclass(frozen=True, eq=False)
class CompiledRhs:
    """A compiled right-hand side, or another function of the same type."""

    function: Any  # the object that the user passed, which is kept alive
    address: int
    user_address: int  # address passed as its last argument, or 0
    name: str = "f"  # in error messages
    requires_data: bool = False  # whether its last argument is a pointer to doubles
    form: RhsForm | None = None  # the form of its results
    extra: ExtraArguments = NO_EXTRA  # without args
    source: Any = None  # the pointer made of ``function``, kept alive as well
    # the parameters of each member with room for the inputs, passed in place of ``user_data``
    data: Any = None

    vectorized: ClassVar[bool] = False
    writes_results: ClassVar[bool] = True  # whether functions of the user write their results

    def on_form(self, form: RhsForm) -> CompiledRhs:
        """Return the function as a right-hand side of a form."""
        return changed(self, form=form)

    def with_data(self, extra: ExtraArguments) -> CompiledRhs:
        """Return the right-hand side with parameters and inputs, such as those of other members.

        ValueError is raised if there are args, if there are parameters or inputs and the user's
        data, or if there is none of these and the function's last argument points to doubles.
        """
        if extra.inputs is not None and self.user_address:
            raise ValueError(
                f"inputs must be None for a compiled {self.name} that has user_data; as parameters "
                "these numbers come before the inputs"
            )
        has_none = extra.parameters is None and extra.inputs is None
        if has_none and self.requires_data and not self.user_address:
            raise ValueError(
                f"parameters must be given for a compiled {self.name} without user_data whose last "
                "argument is of type double *, got None; of type void * it may be null"
            )
        if extra.parameters is not None and self.user_address:
            raise ValueError(
                f"parameters must be None for a compiled {self.name} that has user_data"
            )
        if extra.args:
            raise ValueError(
                f"args must be None for a compiled {self.name}, whose numbers are parameters, "
                f"got {extra.args!r}"
            )
        parameters, inputs = extra.parameters, extra.inputs
        data = parameters if inputs is None else inputs.data_with(parameters)
        return changed(self, extra=extra, data=data)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.function, self.name, self.form, self.extra)

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        distance = 0 if self.data is None or len(self.data) == 1 else self.data.strides[0]
        return self.address, self.data_address, distance

    @property
    def data_address(self) -> int:
        """Address of the data of the first member."""
        return self.user_address if self.data is None else address_of(self.data)

    def failed_name(self, member: int) -> str | None:
        """Return the name of the function that failed last, of a member."""
        return self.name

    def at_member(self, member: int, t: float, y: Points) -> Array:
        """Return the coefficients of a member; RuntimeError if the function returns an error."""
        assert self.form is not None
        return self.form.complete(self.result(member, t, y), y)

    def result(self, member: int, t: float, y: Points) -> Array:
        """Return the result of the function for a member."""
        _, data, distance = self.addresses()
        if (inputs := self.extra.inputs) is not None:
            row = self.data[member if distance else 0]
            row[-inputs.width :] = self.extra.arguments(member)[0].numbers(t)
        return np.asarray(self.values(self.form, data + member * distance, t, y[None])[0])

    def at_times(self, times: Array, y: Points) -> Array:
        """Return the results for a single member at times and points."""
        inputs = self.extra.inputs
        table = () if inputs is None else inputs.table(self.extra.parameters)
        return self.values(self.form, self.data_address, times, y, table)

    def values(self, form: Any, data: int, *arguments: Any) -> Array:
        """Return the results at several points, see `call_rhs` for ``form`` and ``arguments``."""
        return call_rhs(self, self.address, data, form, *arguments)


def call_rhs(
    rhs: Any, address: int, data: int, form: Any, t: float | Array, y: Points, table: Any = ()
) -> Array:
    """Return the results of a function in C at several points, shape ``(len(y), *form.shape)``.

    ``rhs`` names it in messages. ``form``, a `RhsForm` or a `Derivative`, has the frame of points,
    and the shape and the type of a result. The points have one time, or one each, at which inputs
    with a ``table`` are written. Values that the function doesn't write are NaN.
    """
    points = np.array(y, dtype=form.frame.dtype, order="C")  # the function may overwrite them
    values: Array = np.empty((len(y), *form.shape), form.dtype)
    rows, results = (x.reshape(len(y), -1).view(np.float64) for x in (points, values))
    table_address = table.ctypes.data if len(table) else 0
    done, code = core.call_rhs(address, data, 0, table_address, len(table), t, rows.T, results.T)
    if code:
        time, name = float(np.ravel(t)[done if np.ndim(t) else 0]), rhs.failed_name(0)
        raise RuntimeError(f"{name} returned the error code {code} at t = {time:.17g}")
    return values


def _restored(function: Any, name: str, form: RhsForm | None, extra: ExtraArguments) -> CompiledRhs:
    rhs = compiled_rhs(function, name)
    assert rhs is not None
    return rhs if form is None else rhs.on_form(form).with_data(extra)


def compiled_rhs(f: Any, name: str = "f") -> CompiledRhs | None:
    """Return a compiled function as a right-hand side, None if ``f`` isn't compiled.

    It is a `cg.CompiledFunction`, a `scipy.LowLevelCallable`, a function pointer of ctypes with its
    types set, or a ``numba.cfunc``. ValueError, with ``name``, is raised unless its signature is
    ``int (double t, const double *y, double *f, void *user_data)``.
    """
    if isinstance(f, TimeFunction):
        f = f.function
    return f if isinstance(f, CompiledRhs) else _compiled(f, name, SIGNATURE)


def compiled_event(f: Any) -> CompiledRhs | None:
    """Return a compiled function of an event, None if ``f`` isn't compiled."""
    return _compiled(f, "event", EVENT_SIGNATURE)


def _compiled(f: Any, name: str, signature: str) -> CompiledRhs | None:
    if isinstance(f, CompiledFunction):
        return CompiledRhs(f, f.address, f.user_address, name)
    if isinstance(f, FunctionType):
        return None
    # not isinstance, since numba may not be installed
    is_cfunc = hasattr(f, "address") and isinstance(getattr(f, "ctypes", None), _FUNCTION_POINTER)
    source: Any = f.ctypes if is_cfunc else f
    if isinstance(source, _FUNCTION_POINTER):
        if source.argtypes is None:
            raise ValueError(f"{name} must have argtypes and restype of {signature!r}, got {f!r}")
        source = LowLevelCallable(source)
    if not isinstance(source, LowLevelCallable):
        return None
    if not _fits(source.signature, signature):
        raise ValueError(f"{name} must have the signature {signature!r}, got {source.signature!r}")
    # the first item is a capsule, whose context is the address of the user's data
    capsule = tuple.__getitem__(source, 0)
    requires_data = _compact(source.signature).endswith(",double*)")
    addresses = address_in(capsule), data_in(capsule)
    return CompiledRhs(f, *addresses, name, requires_data, source=source)


def _compact(signature: str | None) -> str:
    """Return a signature without spaces and ``const``."""
    return (signature or "").replace("const", "").replace(" ", "")


def _fits(signature: str | None, expected: str) -> bool:
    head, _, data = _compact(signature).rpartition(",")
    return head == expected.replace(" ", "").rpartition(",")[0] and data.endswith("*)")
