"""Functions that users give: their type, functions of shared libraries, functions of time."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from typing import Any

from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.support.arrays import real_array


class CompiledFunction:
    """A function of a shared library as right-hand side.

    Unlike a pointer it can be pickled; another process loads the library again.

    The types of functions in a library aren't known, so that they can't be checked. A function of
    another signature, or one that reads ``user_data`` where neither that nor ``parameters`` is
    given, can end the interpreter.

    Parameters
    ----------
    path
        Path of a shared library, which must exist for every process.
    symbol
        Name of a function ``int (double t, const double *y, double *f, void *user_data)``.
    user_data
        Numbers whose address is passed to the function; they are copied.

    Raises
    ------
    ValueError
        If the library can't be loaded, or has no such function.

    Examples
    --------
    >>> import ctypes.util
    >>> str(CompiledFunction(ctypes.util.find_library("m"), "nextafter").symbol)
    'nextafter'
    """

    def __init__(
        self, path: str | os.PathLike[str], symbol: str, user_data: ArrayLike | None = None
    ) -> None:
        if not isinstance(path, str | os.PathLike):
            raise TypeError(f"path must be a path, got {path!r}")
        if not isinstance(symbol, str):
            raise TypeError(f"symbol must be a string, got {symbol!r}")
        # a name without a folder may be that of a library of the system
        self.path = os.path.abspath(path) if os.path.exists(path) else os.fspath(path)
        self.symbol = symbol
        self.user_data = None if user_data is None else real_array(user_data, "user_data").copy()
        try:
            self._library = ctypes.CDLL(self.path)
        except OSError as error:
            raise ValueError(f"path must be a shared library, got {self.path!r}: {error}") from None
        try:
            function = self._library[symbol]
        except AttributeError:
            raise ValueError(f"symbol must be a function of {self.path}, got {symbol!r}") from None
        self.address = ctypes.cast(function, ctypes.c_void_p).value or 0

    @property
    def user_address(self) -> int:
        """Address of the user's data, or 0."""
        return 0 if self.user_data is None else self.user_data.ctypes.data

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledFunction, (self.path, self.symbol, self.user_data)

    def __repr__(self) -> str:
        data = "" if self.user_data is None else f", {self.user_data.tolist()}"
        return f"CompiledFunction({self.path!r}, {self.symbol!r}{data})"


Function = Callable[..., Any] | CompiledFunction | LowLevelCallable[Any, Any]
"""A function of the user, in Python or compiled."""


class TimeFunction:
    """A function ``f(t, *args)`` of time as a right-hand side, which gets a point as well."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function

    def __call__(self, t: float, y: Any, *args: Any) -> Any:
        """Return the coefficients at a time."""
        return self.function(t, *args)
