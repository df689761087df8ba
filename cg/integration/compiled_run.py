"""Integrations that compiled code keeps between calls."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.arrays import Array
from cg.frames.base import Frame
from cg.integration.blocks import block_constants, describe_blocks
from cg.integration.compiled_rhs import CompiledRhs
from cg.integration.paths import paths_of
from cg.integration.python_rhs import PythonRhs
from cg.integration.stepper import AdaptiveSchedule, error_exponent
from cg.integration.time_grid import TimeGrid
from cg.memory import reserved
from cg.method import Method

__all__ = ["CompiledRun"]


class CompiledRun:
    """Trajectories that begin at the same time, each with what it needs to go on.

    Parameters
    ----------
    rhs
        The right-hand side; one in Python has a single trajectory.
    frame
        One that is compiled.
    method
        An explicit one.
    rows
        Initial points, shape ``(trajectories, numbers of a point)``.
    schedule
        Which steps to take.
    members
        The number of points that a trajectory has and that move as one.
    first
        Whose data of the right-hand side the first trajectory is given.
    """

    def __init__(
        self,
        rhs: CompiledRhs | PythonRhs,
        frame: Frame,
        method: Method,
        rows: Array,
        schedule: TimeGrid | AdaptiveSchedule,
        *,
        members: int = 1,
        first: int = 0,
    ) -> None:
        import cg._external as core

        self._core = core
        self._rhs = rhs  # whose data must live as long
        self._dim = frame.dim * members
        if isinstance(rhs, PythonRhs):
            data = core.python_field(), id(rhs.context), 0
        else:
            stride = rhs.data_stride
            data = rhs.address, rhs.data_address + first * stride, stride
        trajectories, width = rows.shape
        paths = paths_of(method)
        frame_blocks = describe_blocks(frame)
        # blocks of a product's members, each trajectory with its point and slope, and copies
        needed = 64 * members * frame_blocks.shape[1] + trajectories * (
            1024 + 32 * (width + self._dim)
        )
        with reserved(needed, f"{trajectories} trajectories of {width} numbers"):
            self._address: int = core.open(
                frame_blocks, block_constants(frame), members, paths.integers, *paths.doubles,
                *data, schedule.start, rows.T, getattr(schedule, "first_step", None) or 0.0,
            )  # fmt: skip
        weakref.finalize(self, core.close, self._address)
        if isinstance(schedule, TimeGrid):
            core.use_grid(
                self._address, schedule.start, schedule.stop, schedule.h, schedule.last,
                schedule.steps,
            )  # fmt: skip
        else:
            norm = schedule.norm
            shape = (frame.dim,) if norm.in_algebra else frame.point_shape
            core.use_tolerances(
                self._address, schedule.stop, norm.rtol,
                np.broadcast_to(norm.atol, shape).flatten(), not norm.in_algebra,
                error_exponent(method), schedule.max_step,
            )  # fmt: skip

    def advance(
        self,
        part: slice,
        steps: int,
        every: int,
        t: Array,
        points: Array,
        slopes: Array | None,
        column: int | None = None,
    ) -> tuple[NDArray[np.intc], NDArray[np.intc], NDArray[np.intc], Array]:
        """Take some steps of some trajectories, those that have not ended.

        Parameters
        ----------
        part
            Which trajectories.
        steps
            How many steps to try at most.
        every
            How many steps there are between those that are stored; the last is stored always.
        t, points, slopes
            Where the times, points and coefficients at the beginnings of steps are stored, shapes
            ``(capacity,)``, ``(capacity, columns, width)`` and ``(capacity, columns, dim)``; None
            if nobody wants coefficients.
        column
            Where the first of the trajectories is stored; None if all have columns.

        Returns
        -------
        counts
            Steps tried, accepted and stored, evaluations and flows, shape ``(5, len(part))``.
        statuses, flags
            `cg.shared_numbers.Stop`, and what a function in C returned, shape ``(len(part),)``.
        failed_at
            When it failed, or where it pauses; same shape.
        """
        wanted = slopes is not None
        f = np.empty((1, 1, 1)) if slopes is None else slopes
        found: tuple[Any, Any, Any, Any] = self._core.advance(
            self._address, part.start + 1, part.stop, steps, every, wanted,
            (part.start if column is None else column) + 1, t, points.T, f.T,
        )  # fmt: skip
        return found

    def slope(self, i: int) -> tuple[Array, int, int, int]:
        """Return the coefficients where a trajectory is, and how many evaluations they took.

        After them come a status and a flag as of `advance`.
        """
        found: tuple[Array, int, int, int] = self._core.slope(self._address, i + 1, self._dim)
        return found

    def evaluate(self, i: int, t: Array, rows: Array, f: Array) -> tuple[int, int, int]:
        """Evaluate at any times and points with the data of a trajectory.

        Parameters
        ----------
        i
            The trajectory.
        t, rows
            Shapes ``(n,)`` and ``(n, width)``.
        f
            Receives the coefficients, shape ``(n, dim)``.

        Returns
        -------
        done
            How many were evaluated before one failed.
        status, flag
            As of `advance`.
        """
        found: tuple[int, int, int] = self._core.evaluate(self._address, i + 1, t, rows.T, f.T)
        return found

    def finish(self, i: int) -> None:
        """Take no more steps of a trajectory."""
        self._core.finish(self._address, i + 1)

    def forget(self, i: int) -> None:
        """Evaluate the coefficients where a trajectory is anew."""
        self._core.forget(self._address, i + 1)

    def smallest_step(self, t: float) -> float:
        """Return the resolution of time there, below which no step is taken."""
        return float(self._core.smallest_size(t))
