"""Types and addresses of arrays, arguments as arrays, and times at the ends of spans."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from typing import Any, Literal, TypeGuard, get_args

import numpy as np
from numpy.typing import NDArray

from cg.support.checks import check_generator, check_integer, short

Array = NDArray[np.float64]
Points = NDArray[Any]
"""Points and tangents, of type float64 or complex128 as given by `Frame.dtype`."""

Convention = Literal["body", "space"]
CONVENTIONS = get_args(Convention)

_COMPLEX = complex, np.complexfloating
_MAX_POINTS = 2**40  # exceeds the memory of any machine

Size = int | Sequence[int]
"""Leading axes of random points: their lengths, or the length of a single axis."""


def is_array(value: Any, dtype: Any) -> TypeGuard[Points]:
    """Return whether a value is an ndarray of the given dtype, which needs no conversion."""
    return type(value) is np.ndarray and value.dtype == dtype


def address_of(array: Any) -> int:
    """Return the address of an array, of a writeable one faster than by ``array.ctypes``."""
    if array.flags.writeable and array.size:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))
    return int(array.ctypes.data)


def real_array(value: Any, name: str) -> Array:
    """Return ``value`` as a new C-ordered float64 array; ValueError if it isn't real numbers."""
    return _number_array(value, name, np.float64, "iufO", "real")


def complex_array(value: Any, name: str) -> NDArray[np.complex128]:
    """Return ``value`` as a new C-ordered complex128 array; ValueError if it isn't numbers."""
    return _number_array(value, name, np.complex128, "iufcO", "complex")


def number_array(value: Any, name: str) -> Points:
    """Return ``value`` as a complex array if its dtype is complex, else as a real one."""
    try:
        is_complex = np.iscomplexobj(value)
    except (TypeError, ValueError):
        is_complex = False
    return (complex_array if is_complex else real_array)(value, name)


def vectors_of_one_length(name: str, x: Any, errors: Any) -> tuple[Array, Array]:
    """Return x, called ``name``, and errors as vectors; ValueError unless they have one length."""
    numbers, sizes = real_array(x, name), real_array(errors, "errors")
    if numbers.ndim != 1 or numbers.shape != sizes.shape:
        raise ValueError(
            f"{name} and errors must be vectors of one length, got shapes {numbers.shape}, "
            f"{sizes.shape}"
        )
    return numbers, sizes


def is_qobj(value: Any) -> bool:
    """Return whether a value is an operator of QuTiP."""
    return type(value).__name__ == "Qobj" and hasattr(value, "full")


def conversion_hint(value: Any, error: BaseException | None) -> str:
    """Return a hint for a value that is no array: a traced array of JAX, or an object of QuTiP."""
    for item in value if isinstance(value, list | tuple) else [value]:
        if type(item).__name__ == "Qobj":
            return "; the numbers of a Qobj are those of its full()"
    while error is not None:
        if type(error).__module__.partition(".")[0] == "jax":
            return "; cg.jax has the methods for JAX, with gradients"
        error = error.__cause__
    return ""


def _number_array(value: Any, name: str, dtype: type, kinds: str, adjective: str) -> NDArray[Any]:
    try:
        # np.asarray would silently drop the mask
        if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
            raise TypeError("masked entries")
        raw = np.asarray(value)
        if raw.dtype.kind not in kinds:
            raise TypeError(f"dtype {raw.dtype}")
        # NumPy would read None as NaN, text as numbers, and drop imaginary parts
        refused = (type(None), str, bytes) + _COMPLEX * (adjective == "real")
        if raw.dtype.kind == "O" and any(isinstance(entry, refused) for entry in raw.flat):
            raise TypeError("entries that aren't numbers")
        return np.array(raw, dtype=dtype, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(
            f"{name} must be an array of {adjective} numbers, got {short(value)}"
            f"{conversion_hint(value, error)}"
        ) from error


def read_only(array: Points) -> Points:
    """Return a view that can't be written to."""
    view = array.view()
    view.setflags(write=False)
    return view


def check_finite(name: str, array: Points) -> None:
    """Raise ValueError, which names the first non-finite entry, unless an array is finite."""
    finite = np.isfinite(array)
    if np.count_nonzero(finite) < finite.size:  # faster than all()
        index = tuple(np.argwhere(~finite)[0].tolist())
        position = ", ".join(map(str, index))
        raise ValueError(f"{name} must be finite, got {array[index]} at [{position}]")


def check_positive(name: str, array: Points) -> None:
    """Raise ValueError unless an array is finite and positive."""
    if not (np.isfinite(array).all() and (array > 0.0).all()):
        raise ValueError(f"{name} must be finite and positive, got {array}")


def check_random(rng: Any, size: Any) -> tuple[int, ...]:
    """Check the arguments of `random_point` and `random_vector`; return ``size`` as a tuple."""
    check_generator("rng", rng)
    lengths = size if isinstance(size, tuple | list) else (size,)
    axes = tuple(check_integer("size", n, 0) for n in lengths)
    if math.prod(axes) > _MAX_POINTS:
        raise ValueError(f"size must be at most {_MAX_POINTS} in all, got {size!r}")
    return axes


ROUNDINGS = 4
"""How many roundings beyond its ends a span admits: those of a few sums."""


def clipped(times: Array, low: float, high: float) -> tuple[Array, int | None]:
    """Return times moved to the ends of a span that they are beyond by a few roundings.

    The second result is the index of the first time farther beyond or NaN, None if there is none.
    """
    ends = [abs(end) for end in (low, high) if math.isfinite(end)]
    beyond = ROUNDINGS * math.ulp(max(ends, default=0.0))
    outside = ~((times >= low - beyond) & (times <= high + beyond))  # also NaN
    index = int(np.argmax(outside)) if outside.any() else None
    return np.clip(times, low, high), index
