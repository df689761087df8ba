"""Capsules of Python, which hold addresses of compiled functions."""

import ctypes
from functools import cache
from typing import Any

# The order is that in fortran/support/vectors.f90.
_ROUTINES = "dsyrk dpotrf dpotrs dgetrf zgetrf dgetrs zgetrs dgemm zgemm dsyevd"


def address_in(capsule: Any) -> int:
    """Return the address that a capsule holds."""
    name = _call("GetName", ctypes.c_char_p, capsule)
    return int(_call("GetPointer", ctypes.c_void_p, capsule, name))


def data_in(capsule: Any) -> int:
    """Return the address of the data of a function in a capsule, 0 if there are none."""
    return _call("GetContext", ctypes.c_void_p, capsule) or 0


def _call(name: str, result: Any, *arguments: Any) -> Any:
    # attributes of ctypes.pythonapi are shared with other packages, which may set other types
    address = ctypes.cast(getattr(ctypes.pythonapi, f"PyCapsule_{name}"), ctypes.c_void_p).value
    kinds: list[Any] = [ctypes.py_object, ctypes.c_char_p][: len(arguments)]
    return ctypes.PYFUNCTYPE(result, *kinds)(address or 0)(*arguments)


@cache
def provide_lapack() -> None:
    """Give compiled code the addresses of SciPy's routines of BLAS and LAPACK, to link none."""
    from scipy.linalg import cython_blas, cython_lapack

    from cg import _core_r64

    routines = {**cython_lapack.__pyx_capi__, **cython_blas.__pyx_capi__}
    _core_r64.set_lapack([address_in(routines[name]) for name in _ROUTINES.split()])
