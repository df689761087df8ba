"""Right-hand sides that are compiled: C functions, SciPy's LowLevelCallable, numba's cfunc.

The integration of one runs in compiled code from end to end, and Python's lock is released.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import pairwise
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import LowLevelCallable

from cg.frames.base import Array, Frame, Points
from cg.integration.arguments import check_memory
from cg.integration.blocks import describe_blocks
from cg.integration.fixed import check_points, check_span, last_step, step_count
from cg.integration.implicit import StageOverflowError
from cg.integration.pace import Pace
from cg.integration.result import Trajectory
from cg.integration.step import Step
from cg.tableau import Tableau

# Status, what the function returned, time, and trajectory.
_Outcome = tuple[int, int, float, int]

SIGNATURE = "int (double, double *, double *, void *)"
"""What a compiled right-hand side must be; ``const`` may stand anywhere."""

_MOST_STEPS = 2**31 - 1
_FUNCTION_POINTER: Any = ctypes.CFUNCTYPE(None).__mro__[1]
_PROTOTYPE = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_double,
    ctypes.POINTER(ctypes.c_double),
    ctypes.POINTER(ctypes.c_double),
    ctypes.c_void_p,
)


class Stop(IntEnum):
    """Why an integration stopped, by the numbers that fortran/stepper.f90.in has for it."""

    FINISHED = 0
    STOPPED_BY_FIELD = 1
    FIELD_NOT_FINITE = 2
    STAGE_NOT_FINITE = 3
    SOLUTION_NOT_FINITE = 4
    OUT_OF_MEMORY = 5
    PAUSED = 6
    STEP_TOO_SMALL = 7
    SLOPE_NOT_FINITE = 8


@dataclass(frozen=True)
class CompiledRhs:
    """A compiled right-hand side.

    It can be called from Python too, as ``f(t, y)``, for what the compiled integrator can't do.
    Its pickle holds no function, so that solutions can be pickled; a call is an error then.

    Attributes
    ----------
    function
        What the user gave; it is kept alive.
    address
        Address of the function.
    user_data
        Address that it is given as its last argument, or 0.
    frame
        The frame that it gives coefficients for; needed to call it from Python.
    """

    function: Any
    address: int
    user_data: int
    frame: Frame | None = None

    def __reduce__(self) -> tuple[type[CompiledRhs], tuple[None, int, int, Frame | None]]:
        # An address means nothing in another process.
        return CompiledRhs, (None, 0, 0, self.frame)

    def __copy__(self) -> CompiledRhs:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> CompiledRhs:
        return self

    def on(self, frame: Frame) -> CompiledRhs:
        """Return the same right-hand side for points of ``frame``, to be called from Python."""
        return replace(self, frame=frame)

    def __call__(self, t: float, y: Points) -> Array:
        """Return the coefficients, shape ``(*batch, dim)``; what the function leaves out is NaN.

        Parameters
        ----------
        t
            Time.
        y
            Points, shape ``(*batch, *point_shape)``.

        Raises
        ------
        ValueError
            If no frame has been given.
        RuntimeError
            If the function returns another number than zero, or was lost in a pickle.
        """
        if not self.address:
            raise RuntimeError(
                "f is compiled code, which can't be pickled: the solution needs it here, at "
                f"t = {t:.17g}, but was read from a pickle"
            )
        if self.frame is None:
            raise ValueError("frame must be given before a compiled f is called")
        rank = len(self.frame.point_shape)
        points = np.array(y, dtype=self.frame.dtype, order="C")
        batch = points.shape[: points.ndim - rank]
        rows = points.reshape(math.prod(batch), -1).view(np.float64)
        coefficients = np.full((len(rows), self.frame.dim), math.nan)
        pointer = ctypes.POINTER(ctypes.c_double)
        call = _PROTOTYPE(self.address)
        for row, values in zip(rows, coefficients, strict=True):
            code = call(
                t, row.ctypes.data_as(pointer), values.ctypes.data_as(pointer), self.user_data
            )
            if code:
                raise RuntimeError(f"f returned the error code {code} at t = {t:.17g}")
        return coefficients.reshape(*batch, self.frame.dim)


def compiled_rhs(f: Any) -> CompiledRhs | None:
    """Return what the compiled integrator needs of ``f``, or None if it is no compiled function.

    Parameters
    ----------
    f
        A `scipy.LowLevelCallable`, a function pointer of ctypes with its types set, or a
        ``numba.cfunc``, of the signature ``int (double t, const double *y, double *f,
        void *user_data)``.

    Returns
    -------
    CompiledRhs or None

    Raises
    ------
    ValueError
        If ``f`` is compiled but has another signature.
    """
    # A cfunc's type can't be named here, since numba may not be installed.
    is_cfunc = hasattr(f, "address") and isinstance(getattr(f, "ctypes", None), _FUNCTION_POINTER)
    source: Any = f.ctypes if is_cfunc else f
    if isinstance(source, _FUNCTION_POINTER):
        if source.argtypes is None:
            raise ValueError(f"f must have argtypes and restype of {SIGNATURE!r}, got {f!r}")
        source = LowLevelCallable(source)
    if not isinstance(source, LowLevelCallable):
        return None
    if not _fits(source.signature):
        raise ValueError(f"f must have the signature {SIGNATURE!r}, got {source.signature!r}")
    # SciPy keeps a capsule there, whose context is the user's data.
    capsule = tuple.__getitem__(source, 0)
    name = _capsule("GetName", ctypes.c_char_p, capsule)
    address = _capsule("GetPointer", ctypes.c_void_p, capsule, name)
    user_data = _capsule("GetContext", ctypes.c_void_p, capsule)
    return CompiledRhs((f, source), address, user_data or 0)


def integrate_compiled(
    rhs: CompiledRhs,
    t_span: Sequence[float],
    y0: ArrayLike,
    *,
    frame: Frame,
    tableau: Tableau,
    h: float,
    save_every: int = 1,
    workers: int = 1,
) -> Trajectory:
    """Integrate a compiled right-hand side with a fixed step; see `cg.integrate`.

    Raises
    ------
    TypeError
        If ``h`` isn't a real number.
    ValueError
        If an argument has an impossible value, the frame is not compiled or the method implicit,
        or the function gives numbers that aren't finite.
    RuntimeError
        If the function returns anything but zero.
    OverflowError
        If the solution exceeds the range of floating point.
    MemoryError
        If there isn't enough memory.
    """
    import cg._external as core

    if not tableau.explicit:
        raise ValueError(f"method must be explicit for a compiled f, got the implicit {tableau!r}")
    description = describe_blocks(frame)
    start, stop = check_span(t_span)
    steps = step_count((start, stop), h)
    check_step_count(steps)
    points = check_points(frame, y0)
    batch = points.shape[: points.ndim - len(frame.point_shape)]
    # the results are put in order in a second array
    check_memory(h, 0, 2 * points.nbytes * stored_count(steps, save_every))
    kept = stored_steps(steps, save_every)
    trajectories = math.prod(batch)
    rows = points.reshape(trajectories, -1).view(np.float64)
    y = np.empty((trajectories, len(kept), rows.shape[1]))
    y[:, 0] = rows

    step = Step(rhs, frame, tableau)
    b = np.zeros(tableau.stages)
    for j, weight in step.weights:
        b[j] = weight
    size = last = math.copysign(float(h), stop - start)
    if steps:
        last = last_step(start + (steps - 1) * size, stop, size)

    interrupted = Event()

    def run(part: slice) -> _Outcome:
        columns = y[part].T
        position = np.zeros(2, dtype=np.intc)
        point = np.empty(y.shape[-1])
        pace = Pace()
        status, flag, failed_at = int(Stop.PAUSED), 0, math.nan
        while status == Stop.PAUSED and not interrupted.is_set():
            before = int(position[0]) * steps + int(position[1])
            status, flag, failed_at = core.run(
                rhs.address, rhs.user_data, description, tableau.a, b, start, size, last,
                steps, min(save_every, _MOST_STEPS), columns, pace.start(), position, point,
            )  # fmt: skip
            pace.stop(int(position[0]) * steps + int(position[1]) - before)
        return status, flag, failed_at, part.start + int(position[0])

    outcomes = _spread(run, trajectories, workers, interrupted)
    for status, flag, failed_at, failed in outcomes:
        if status != Stop.FINISHED:
            index = tuple(map(int, np.unravel_index(failed, batch))) if batch else None
            raise failure(Stop(status), flag, failed_at, index)

    stored = np.ascontiguousarray(np.moveaxis(y, 0, 1)).view(points.dtype)
    stored = stored.reshape(len(kept), *points.shape)
    t = start + size * kept.astype(np.float64)
    t[-1] = stop
    t.flags.writeable = stored.flags.writeable = False
    nexp = steps * (sum(map(len, step.rows)) + len(step.weights))
    return Trajectory(t, stored, steps * tableau.stages, nexp, tableau, float(h))


def check_step_count(steps: int) -> None:
    """Raise ValueError if there are more steps than compiled code can count."""
    if steps > _MOST_STEPS:
        raise ValueError(f"h is too small for a compiled f: more than {_MOST_STEPS} steps")


def _spread(
    run: Callable[[slice], _Outcome], trajectories: int, workers: int, interrupted: Event
) -> list[_Outcome]:
    """Run an ensemble in parts, each in a thread of its own if there is more than one."""
    bounds = [trajectories * k // workers for k in range(workers + 1)]
    parts = [slice(*pair) for pair in pairwise(bounds) if pair[0] < pair[1]]
    if len(parts) == 1:
        return [run(parts[0])]
    with ThreadPoolExecutor(len(parts)) as pool:
        try:
            return list(pool.map(run, parts))
        except BaseException:  # the threads know nothing of an interrupt
            interrupted.set()
            raise


def stored_steps(steps: int, save_every: int) -> NDArray[np.int64]:
    """Return the numbers of the steps whose results are kept: every k-th, and the last."""
    return np.append(np.arange(0, steps, save_every), steps)


def stored_count(steps: int, save_every: int) -> int:
    """Return how many steps `stored_steps` has."""
    return len(range(0, steps, save_every)) + 1


def _capsule(name: str, result: Any, *arguments: Any) -> Any:
    address = ctypes.cast(getattr(ctypes.pythonapi, f"PyCapsule_{name}"), ctypes.c_void_p).value
    kinds: list[Any] = [ctypes.py_object, ctypes.c_char_p][: len(arguments)]
    return ctypes.PYFUNCTYPE(result, *kinds)(address or 0)(*arguments)


def _fits(signature: str | None) -> bool:
    words = (signature or "").replace("const", "").replace(" ", "")
    head, _, data = words.rpartition(",")
    return head == "int(double,double*,double*" and data.endswith("*)")


def failure(stop: Stop, flag: int, t: float, index: tuple[int, ...] | None) -> Exception:
    """Return the exception for an integration that ``f`` or its numbers ended.

    Parameters
    ----------
    stop
        Why it ended.
    flag
        What the function returned.
    t
        When.
    index
        The member of an ensemble, or None for a single trajectory.
    """
    where = f"at t = {t:.17g}"
    if index is not None:
        where += f" for y0[{', '.join(map(str, index))}]"
    match stop:
        case Stop.STOPPED_BY_FIELD:
            return RuntimeError(f"f returned the error code {flag} {where}")
        case Stop.FIELD_NOT_FINITE:
            return ValueError(f"f must return finite numbers, and all of them, {where}")
        case Stop.STAGE_NOT_FINITE:
            return StageOverflowError(f"a stage is no longer finite {where}")
        case Stop.SOLUTION_NOT_FINITE:
            return OverflowError(f"the solution is no longer finite {where}")
    return MemoryError("there is not enough memory for the stages of one step")
