"""Right-hand sides that are compiled: C functions, SciPy's LowLevelCallable, numba's cfunc."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import LowLevelCallable

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.rhs.function import CompiledFunction, TimeFunction
from cg.support.capsules import address_in, context_of

SIGNATURE = "int (double, double *, double *, void *)"
"""What a compiled right-hand side must be; ``const`` may stand anywhere."""

EVENT_SIGNATURE = "double (double, double *, void *)"
"""What a compiled event must be; ``const`` may stand anywhere."""

_FUNCTION_POINTER: Any = ctypes.CFUNCTYPE(None).__mro__[1]


@dataclass(frozen=True)
class CompiledRhs:
    """A compiled right-hand side.

    It can also be called from Python as ``f(t, y)``.

    Attributes
    ----------
    function
        The object that the user passed, which is kept alive.
    address
        Address of the function.
    user_data
        Address passed as its last argument, or 0.
    parameters
        The parameters of each member of an ensemble, shape ``(*batch, k)``, or None.  The function
        receives the address of those of its member in place of ``user_data``.
    frame
        The frame of its points, needed to call it from Python.
    requires_data
        Whether its last argument is a pointer to doubles, so that it needs data.
    """

    function: Any
    address: int
    user_data: int
    parameters: Array | None = None
    frame: Frame | None = None
    requires_data: bool = False

    def on(self, frame: Frame, parameters: Array | None) -> CompiledRhs:
        """Return the right-hand side on a frame, with parameters of shape ``(members, k)``.

        ValueError is raised if there are parameters and user's data, or if there are neither and
        the function's last argument is a pointer to doubles.
        """
        if parameters is None and self.requires_data and not self.user_data:
            raise ValueError(
                "parameters must be given for a compiled f without user_data whose last "
                "argument is of type double *, got None; of type void * it may be null"
            )
        if parameters is not None and self.user_data:
            raise ValueError("parameters must be None for a compiled f that has user_data")
        return replace(self, frame=frame, parameters=parameters)

    vectorized = False
    """Whether it takes points of several members in one call."""

    has_args = False
    """Whether further arguments are included."""

    @property
    def name(self) -> str:
        """Its name in error messages."""
        return "f"

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        distance = 0 if self.parameters is None else 8 * self.parameters.shape[-1]
        return self.address, self.data_address, distance

    @property
    def data_address(self) -> int:
        """Address of the data of the first member."""
        return self.user_data if self.parameters is None else int(self.parameters.ctypes.data)

    def at_member(self, member: int, t: float, y: Points) -> Array:
        """Return the coefficients of a member; RuntimeError if the function returns an error."""
        answer = self.answer(member, t, y)
        return answer if self.frame is None else self.frame.complete_rhs(answer, y)

    def answer(self, member: int, t: float, y: Points) -> Array:
        """Return what the function returns for a member."""
        own = None if self.parameters is None else self.parameters[member]
        return replace(self, parameters=own)(t, y)

    def part(self, members: slice) -> CompiledRhs:
        """Return the right-hand side of some of the members."""
        own = None if self.parameters is None else self.parameters[members]
        return replace(self, parameters=own)

    def __call__(self, t: float, y: Points) -> Array:
        """Return what the function writes, shape ``(*batch, frame.rhs_dim)``, NaN where nothing.

        Points have the shape ``(*batch, *point_shape)``.  RuntimeError is raised if the function
        returns another number than zero, ValueError if the frame is unknown.
        """
        if self.frame is None:
            raise ValueError("frame must be given before a compiled f is called")
        import cg._core_r64 as core

        points = np.array(
            y, dtype=self.frame.dtype, order="C"
        )  # a copy, which the function may overwrite
        batch = points.shape[: points.ndim - len(self.frame.point_shape)]
        members = math.prod(batch)
        coefficients = np.empty((members, self.frame.rhs_dim))
        if members:
            rows = points.reshape(members, -1).view(np.float64)
            _, code = core.call_field(*self.addresses(), t, rows.T, coefficients.T)
            if code:
                raise RuntimeError(f"f returned the error code {code} at t = {t:.17g}")
        return coefficients.reshape(*batch, self.frame.rhs_dim)


def compiled_rhs(f: Any, name: str = "f") -> CompiledRhs | None:
    """Return a compiled function as a right-hand side, None if ``f`` isn't compiled.

    It is a `cg.CompiledFunction`, a `scipy.LowLevelCallable`, a function pointer of ctypes with its
    types set, or a ``numba.cfunc``.  ValueError, with ``name``, is raised unless its signature is
    ``int (double t, const double *y, double *f, void *user_data)``.
    """
    if isinstance(f, TimeFunction):
        f = f.a
    if isinstance(f, CompiledRhs):
        return f
    if isinstance(f, CompiledFunction):
        return CompiledRhs(f, f.address, f.data_address)
    source = _low_level(f, name, SIGNATURE)
    if source is None:
        return None
    if not _fits(source.signature, SIGNATURE):
        raise ValueError(f"{name} must have the signature {SIGNATURE!r}, got {source.signature!r}")
    requires_data = _words(source.signature).endswith(",double*)")
    return CompiledRhs((f, source), *_addresses(source), requires_data=requires_data)


@dataclass(frozen=True)
class CompiledEvent:
    """A compiled function of an event.

    Attributes
    ----------
    function
        The object that the user passed, which is kept alive.
    address, user_data
        Address of the function, and of its data, 0 for those of the right-hand side.
    """

    function: Any
    address: int
    user_data: int


def compiled_event(f: Any) -> CompiledEvent | None:
    """Return a compiled function as an event, None if ``f`` isn't compiled.

    ValueError is raised unless its signature is `EVENT_SIGNATURE`.
    """
    if isinstance(f, CompiledFunction):
        return CompiledEvent(f, f.address, f.data_address)
    source = _low_level(f, "event", EVENT_SIGNATURE)
    if source is None:
        return None
    if not _fits(source.signature, EVENT_SIGNATURE):
        raise ValueError(
            f"event must have the signature {EVENT_SIGNATURE!r}, got {source.signature!r}"
        )
    return CompiledEvent((f, source), *_addresses(source))


def _low_level(f: Any, name: str, signature: str) -> Any:
    """Return a compiled function as a `LowLevelCallable`, None if ``f`` isn't compiled."""
    # not isinstance, since numba may not be installed
    is_cfunc = hasattr(f, "address") and isinstance(getattr(f, "ctypes", None), _FUNCTION_POINTER)
    source: Any = f.ctypes if is_cfunc else f
    if isinstance(source, _FUNCTION_POINTER):
        if source.argtypes is None:
            raise ValueError(f"{name} must have argtypes and restype of {signature!r}, got {f!r}")
        source = LowLevelCallable(source)
    return source if isinstance(source, LowLevelCallable) else None


def _addresses(source: Any) -> tuple[int, int]:
    """Return the addresses of a function and of its data."""
    # the first item is a capsule, whose context is the address of the user's data
    capsule = tuple.__getitem__(source, 0)
    return address_in(capsule), context_of(capsule)


def _words(signature: str | None) -> str:
    """Return a signature without spaces and ``const``."""
    return (signature or "").replace("const", "").replace(" ", "")


def _fits(signature: str | None, expected: str) -> bool:
    head, _, data = _words(signature).rpartition(",")
    return head == expected.replace(" ", "").rpartition(",")[0] and data.endswith("*)")
