"""The heavy top as a compiled right-hand side, and as a loop by hand in C."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import LowLevelCallable

from cg import Method, Tableau
from cg.problems import HeavyTop

__all__ = ["CompiledTop"]

_DOUBLES = ctypes.POINTER(ctypes.c_double)
_INTEGERS = ctypes.POINTER(ctypes.c_int)


class CompiledTop:
    """The C code of ``heavy_top.c`` for one top.

    Parameters
    ----------
    top : HeavyTop
    folder : Path
        Where the library goes; it must outlive this object.

    Attributes
    ----------
    f : scipy.LowLevelCallable
        The right-hand side.
    jac : ctypes function
        Its derivatives along the frame's fields, which need its data.
    """

    def __init__(self, top: HeavyTop, folder: Path) -> None:
        source = Path(__file__).with_name("heavy_top.c")
        target = folder / "heavy_top.so"
        options = ["-O3", "-Wall", "-Wextra", "-shared", "-fPIC"]
        subprocess.run(["gcc", *options, "-o", target, source, "-lm"], check=True)
        library = ctypes.CDLL(str(target))
        self.top = top
        inverses = [float(1 / moment) for moment in top.inertia]
        self.constants = np.array([*inverses, float(top.mgl)])
        library.heavy_top.restype = ctypes.c_int
        library.heavy_top.argtypes = [ctypes.c_double, _DOUBLES, _DOUBLES, ctypes.c_void_p]
        # as data_as makes it, the pointer keeps the constants, also where only f is kept
        self.f: Any = LowLevelCallable(
            library.heavy_top, self.constants.ctypes.data_as(ctypes.c_void_p)
        )
        self.jac = library.heavy_top_jac
        self.jac.restype, self.jac.argtypes = ctypes.c_int, library.heavy_top.argtypes
        self._loop = library.integrate
        self._loop.restype = None
        self._loop.argtypes = [
            ctypes.c_int, _DOUBLES, _DOUBLES, ctypes.c_double, ctypes.c_int, _DOUBLES, _DOUBLES,
        ]  # fmt: skip
        self._points = library.integrate_points
        self._points.restype = None
        self._points.argtypes = [
            ctypes.c_int, _INTEGERS, _DOUBLES, _INTEGERS, ctypes.c_int, ctypes.c_double,
            ctypes.c_int, _DOUBLES, _DOUBLES,
        ]  # fmt: skip

    def integrate(self, method: Tableau, h: float, steps: int) -> NDArray[np.float64]:
        """Return all points, shape ``(steps + 1, 12)``, from the loop by hand."""
        y = np.empty((steps + 1, 12))
        y[0] = self.top.y0
        a, b = np.ascontiguousarray(method.a), np.ascontiguousarray(method.b)
        arrays = [x.ctypes.data_as(_DOUBLES) for x in (a, b, self.constants, y)]
        self._loop(method.stages, *arrays[:2], h, steps, *arrays[2:])
        return y

    def follow(self, method: Method, h: float, steps: int) -> NDArray[np.float64]:
        """Return the same of a tree of points, for methods that are no tableaux."""
        y = np.empty((steps + 1, 12))
        y[0] = self.top.y0
        weights = np.zeros((len(method.points), method.stages))
        for row, point in zip(weights, method.points, strict=True):
            for stage, weight in point.weights.items():
                row[stage] = float(weight)
        parents = np.array([point.parent for point in method.points], dtype=np.intc)
        stages = np.array(method.stage_points, dtype=np.intc)
        self._points(
            method.stages, parents.ctypes.data_as(_INTEGERS),
            weights.ctypes.data_as(_DOUBLES), stages.ctypes.data_as(_INTEGERS), method.result, h,
            steps, self.constants.ctypes.data_as(_DOUBLES), y.ctypes.data_as(_DOUBLES),
        )  # fmt: skip
        return y
