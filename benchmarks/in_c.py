"""Right-hand sides in C, and a plain loop in C that takes steps with them."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

import cg
from cg.problems import HeavyTop

# as steps.c reads them, after the numbers of paths, flows, terms and stages
_INTEGERS = ("origin", "path_first", "flow_first", "flow_stage", "stage_path")


def build(name: str, folder: Path) -> Path:
    """Compile ``name.c`` as the package is compiled, and return the library."""
    library = folder / f"{name}.so"
    options = ["-O3", "-Wall", "-Wextra", "-shared", "-fPIC"]
    source = Path(__file__).with_name(f"{name}.c")
    subprocess.run(["gcc", *options, "-o", library, source, "-lm"], check=True)
    return library


def field(symbol: str, folder: Path, data: ArrayLike | None = None) -> cg.CompiledFunction:
    """Return a function of ``fields.c``; the library in the folder must outlive it."""
    library = folder / "fields.so"
    return cg.CompiledFunction(
        library if library.exists() else build("fields", folder), symbol, data
    )


def top_field(
    top: HeavyTop, folder: Path, symbol: Literal["heavy_top", "heavy_top_jac"] = "heavy_top"
) -> cg.CompiledFunction:
    """Return the right-hand side of a heavy top, or its derivatives along the frame's fields."""
    inverses = [float(1 / moment) for moment in top.inertia]
    return field(symbol, folder, [*inverses, float(top.mgl)])


class PlainLoop:
    """The loop of ``steps.c``.

    Parameters
    ----------
    folder : Path
        Where the library goes; it must outlive this object.
    """

    def __init__(self, folder: Path) -> None:
        self._integrate = ctypes.CDLL(str(build("steps", folder))).integrate
        reals = np.ctypeslib.ndpointer(np.float64, flags="C")
        integers = np.ctypeslib.ndpointer(np.intc, flags="C")
        self._integrate.argtypes = [
            ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, integers, reals, reals,
            ctypes.c_double, ctypes.c_int, ctypes.c_int, reals, reals,
        ]  # fmt: skip

    def integrate(
        self, f: cg.CompiledFunction, method: str, h: float, steps: int, y0: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return where steps from points lead, of shape ``(members, 12)`` or ``(members, 7)``."""
        table, end = cg.methods[method].table(), np.empty_like(y0)
        record, arrays = table.record, table.arrays
        if record.series or record.registers or record.final_stage:
            raise ValueError(f"method must be one that steps.c can follow, got {method!r}")
        numbers = [record.paths, record.flows, record.terms, record.stages]
        integers = np.concatenate(
            [numbers, *(arrays[name] for name in _INTEGERS), [record.result]], dtype=np.intc
        )
        if self._integrate(
            y0.shape[1] - 3, f.address, f.data_address, integers, arrays["weight"],
            table.c, h, steps, len(y0), y0, end,
        ):  # fmt: skip
            raise RuntimeError("f returned an error")
        return end
