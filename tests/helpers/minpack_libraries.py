"""Flags of Fortran with all checks, and Debian's MINPACK."""

import ctypes
import ctypes.util
import shutil
from pathlib import Path

import numpy as np

TESTS = Path(__file__).parents[1]
SOURCES = TESTS.parent / "fortran"
KINDS = ("r64", "r128")
FLAGS = [
    "-O1", "-g", "-frecursive", "-fimplicit-none", "-Wall", "-Wextra", "-Wconversion-extra",
    "-Wno-compare-reals", "-Wno-unused-dummy-argument", "-Werror",
    "-fcheck=all", "-ffpe-trap=invalid,zero,overflow",
]  # fmt: skip

HAS_COMPILER = shutil.which("gfortran") is not None

C_DOUBLES = ctypes.POINTER(ctypes.c_double)
C_INTS = ctypes.POINTER(ctypes.c_int)


def load_debian_minpack():
    name = ctypes.util.find_library("minpack")
    return None if name is None else ctypes.CDLL(name)


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


def reference(value):
    kind = ctypes.c_int if isinstance(value, int) else ctypes.c_double
    return ctypes.byref(kind(value))


class DebianMinpack:
    """MINPACK's Fortran subroutines as Debian compiles them."""

    EPS = 2.22044604926e-16  # its dpmpar(1): the machine precision rounded to twelve digits

    def __init__(self, library):
        self._library = library
        library.enorm_.restype = ctypes.c_double

    def lmdif(self, f, x0, m, *, ftol, xtol, gtol, maxfev, epsfcn, factor):
        n = x0.size
        x, fvec, fjac = x0.copy(), np.empty(m), np.empty((m, n), order="F")
        diag, qtf, ipvt = np.ones(n), np.empty(n), np.empty(n, np.intc)
        work = [np.empty(n), np.empty(n), np.empty(n), np.empty(m)]
        info, nfev = ctypes.c_int(), ctypes.c_int()

        def callback(_m, _n, x_in, f_out, _flag):
            at = np.ctypeslib.as_array(x_in, (n,)).copy()
            np.ctypeslib.as_array(f_out, (m,))[:] = f(at)

        signature = ctypes.CFUNCTYPE(None, C_INTS, C_INTS, C_DOUBLES, C_DOUBLES, C_INTS)
        self._library.lmdif_(
            signature(callback),
            reference(m), reference(n), pointer(x), pointer(fvec),
            reference(ftol), reference(xtol), reference(gtol),
            reference(maxfev), reference(epsfcn), pointer(diag), reference(1),
            reference(factor), reference(0), ctypes.byref(info), ctypes.byref(nfev),
            pointer(fjac), reference(m), pointer(ipvt), pointer(qtf),
            *(pointer(array) for array in work),
        )  # fmt: skip
        return {
            "x": x, "fvec": fvec, "info": info.value, "nfev": nfev.value, "fjac": fjac,
            "ipvt": ipvt - 1, "qtf": qtf,
        }  # fmt: skip
