"""Steps of an explicit method in compiled code, for a right-hand side in C or in Python."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.compiled_rhs import CompiledRhs
from cg.integration.compiled_run import CompiledRun
from cg.integration.messages import failure, too_many_steps, too_small_a_step
from cg.integration.python_rhs import PythonRhs
from cg.integration.step_budget import StepBudget
from cg.integration.stepper import (
    AdaptiveSchedule,
    Block,
    Stepper,
)
from cg.integration.time_grid import TimeGrid, stored_count
from cg.method import Method
from cg.shared_numbers import Stop

__all__ = ["CompiledStepper"]

# With a compiled f, the fewer the less is computed beyond the event that ends it all.
_STEPS_BETWEEN_EVENTS = 64


class CompiledStepper(Stepper):
    """Steps in compiled code.

    Points of an ensemble move as one for a function in Python, which is given all of them, and
    one after the other for a function in C.

    Parameters
    ----------
    rhs
        The right-hand side.
    frame
        One that is compiled.
    method
        An explicit one.
    batch
        Leading axes.
    points
        Initial points, shape ``(*batch, *point_shape)``.
    schedule
        Which steps to take.  An ensemble for a function in C has a grid.
    slopes
        Whether blocks have slopes.
    every
        How many steps of a grid there are between those that blocks have.
    workers
        Number of threads over which an ensemble for a function in C is spread.
    watched
        Whether each block is looked through for the event that ends it all.
    keep
        Whether to keep all steps of a grid in one piece.
    """

    def __init__(
        self,
        rhs: CompiledRhs | PythonRhs,
        frame: Frame,
        method: Method,
        batch: tuple[int, ...],
        points: Points,
        schedule: TimeGrid | AdaptiveSchedule,
        *,
        slopes: bool = False,
        every: int = 1,
        workers: int = 1,
        watched: bool = False,
        keep: bool = False,
    ) -> None:
        super().__init__(frame, method, batch)
        self.rhs = rhs
        self.schedule = schedule
        self.slopes = slopes
        self.every = every
        self.workers = workers
        in_python = isinstance(rhs, PythonRhs)
        self.most_steps = (1 if in_python else _STEPS_BETWEEN_EVENTS) if watched else 2**30
        self.trajectories = 1 if in_python else math.prod(batch)
        rows = np.ascontiguousarray(points).reshape(self.trajectories, -1).view(np.float64)
        self.start = points
        self.width = rows.shape[1]
        members = math.prod(batch) if in_python else 1
        self.dim = frame.dim * members
        self._run = CompiledRun(rhs, frame, method, rows, schedule, members=members)
        self._done = 0
        self._piece: tuple[Array, Points] | None = None
        if keep and isinstance(schedule, TimeGrid):
            # what is written where it stays needs no other memory, and no copying
            kept = stored_count(schedule.steps, every)
            self._piece = np.empty(kept), np.empty((kept, *points.shape), dtype=points.dtype)
            self._piece[0][0], self._piece[1][0] = schedule.start, points
        self._reached = schedule.start

    @property
    def whole(self) -> tuple[Array, Points] | None:
        """Times and points of all steps so far, if they are kept in one piece."""
        if self._piece is None:
            return None
        return self._piece[0][: self._done + 1], self._piece[1][: self._done + 1]

    def blocks(self) -> Iterator[Block]:
        """Give the steps, as many at a time as Python may wait for."""
        t, y = self.schedule.start, self.start
        adaptive = isinstance(self.schedule, AdaptiveSchedule)
        left = self.schedule.max_steps if adaptive else self.schedule.steps  # type: ignore[union-attr]
        budget = StepBudget()
        going = self.schedule.start != self.schedule.stop
        while going and left > 0:
            steps = min(budget.start(), self.most_steps, left)
            steps = max(1, steps // self.trajectories)
            block, attempts, statuses, flags, failed_at = self._advance(steps, t, y)
            budget.stop(attempts * self.trajectories)
            left -= attempts
            if len(block):
                t, y = float(block.t[-1]), block.y[-1]
                self._reached = t
                yield block
            going = self._judge(statuses, flags, failed_at, t)
        if adaptive and going:
            self.trouble = too_many_steps(self.schedule.max_steps, t)  # type: ignore[union-attr]

    def _advance(
        self, steps: int, t: float, y: Points
    ) -> tuple[Block, int, NDArray[np.intc], NDArray[np.intc], Array]:
        """Take some steps of all trajectories."""
        capacity = (steps - 1) // self.every + 2  # wherever these begin, and the very last one
        if self._piece is None:
            times = np.empty(capacity + 1)
            points = np.empty((capacity + 1, self.trajectories, self.width))
            times[0] = t
            points[0] = np.ascontiguousarray(y).view(np.float64).reshape(points.shape[1:])
        else:
            part = slice(self._done, min(self._done + capacity + 1, len(self._piece[0])))
            times = self._piece[0][part]
            flat = self._piece[1].reshape(len(self._piece[0]), self.trajectories, -1)
            points = flat.view(np.float64)[part]
            capacity = len(times) - 1
        slopes = np.empty((capacity, self.trajectories, self.dim)) if self.slopes else None

        def run(part: slice) -> tuple[Any, ...]:
            return self._run.advance(part, steps, self.every, times[1:], points[1:], slopes)

        parts = self._spread(run)
        counts, statuses, flags, failed_at = (
            np.concatenate([part[k] for part in parts], axis=-1) for k in range(4)
        )
        attempts, accepted, stored, nfev, nexp = counts.max(axis=1).tolist()
        self.counts.steps += accepted
        if isinstance(self.schedule, AdaptiveSchedule):
            self.counts.rejected += attempts - accepted
        self.counts.nfev += nfev
        self.counts.nexp += nexp
        for i in np.flatnonzero(counts[2] < stored).tolist():
            points[counts[2, i] + 1 :, i] = math.nan
            if slopes is not None:
                slopes[counts[2, i] :, i] = math.nan
        self._done += stored
        shape = (stored + 1, *self.batch, *self.frame.point_shape)
        block = Block(
            times[: stored + 1],
            points[: stored + 1].view(self.frame.dtype).reshape(shape),
            None
            if slopes is None
            else slopes[:stored].reshape(stored, *self.batch, self.frame.dim),
        )
        return block, attempts, statuses, flags, failed_at

    def _spread(self, run: Callable[[slice], tuple[Any, ...]]) -> list[tuple[Any, ...]]:
        """Run parts of an ensemble, each in a thread of its own if there is more than one."""
        total = self.trajectories
        bounds = [total * k // self.workers for k in range(self.workers + 1)]
        parts = [slice(*pair) for pair in pairwise(bounds) if pair[0] < pair[1]]
        if len(parts) == 1:
            return [run(parts[0])]
        with ThreadPoolExecutor(len(parts)) as pool:
            return list(pool.map(run, parts))

    def _judge(
        self, statuses: NDArray[np.intc], flags: NDArray[np.intc], failed_at: Array, t: float
    ) -> bool:
        """Raise what went wrong, or note it of a member; return whether to go on."""
        going = statuses == Stop.PAUSED
        for i in np.flatnonzero(~going & (statuses != Stop.FINISHED)).tolist():
            stop = Stop(statuses[i])
            if stop is Stop.STEP_TOO_SMALL:
                self.trouble = too_small_a_step(t, self._run.smallest_step(t))
                continue
            index: tuple[int, ...] = ()
            if self.trajectories > 1:
                index = tuple(map(int, np.unravel_index(i, self.batch)))
            slope = self._run.slope(i)[0] if stop is Stop.SLOPE_NOT_FINITE else None
            error = failure(stop, int(flags[i]), float(failed_at[i]), slope)
            if not self.batch or (self.trajectories == 1 and isinstance(self.rhs, PythonRhs)):
                raise error
            self.failures.setdefault(index or (0,) * len(self.batch), str(error))
        return bool(going.any())

    def last_slope(self) -> Array:
        """Return the coefficients where the trajectories are, which the next step won't need."""
        found = []
        for i in range(self.trajectories):
            slope, evaluations, status, flag = self._run.slope(i)
            if status != Stop.FINISHED:
                if isinstance(self.rhs, PythonRhs) or not self.batch:
                    raise failure(Stop(status), flag, self._reached)
                slope = np.full(self.dim, math.nan)
            found.append(slope)
        self.counts.nfev += evaluations
        return np.array(found).reshape(*self.batch, self.frame.dim)

    def evaluate(self, t: Array, y: Points) -> Array:
        """Return coefficients at times ``(n,)`` and points ``(n, *batch, *point_shape)``."""
        self.counts.nfev += len(t)
        values = np.empty((self.trajectories, len(t), self.dim))
        rows = np.ascontiguousarray(y).reshape(len(t), self.trajectories, -1).view(np.float64)
        for i in range(self.trajectories):
            if not np.isfinite(rows[:, i]).all():  # it has failed or ended
                values[i] = math.nan
                continue
            done, status, flag = self._run.evaluate(
                i, t, np.ascontiguousarray(rows[:, i]), values[i]
            )
            if status != Stop.FINISHED:
                if isinstance(self.rhs, PythonRhs) or not self.batch:
                    raise failure(Stop(status), flag, float(t[done]))
                values[i, done:] = math.nan
        return np.moveaxis(values, 0, 1).reshape(len(t), *self.batch, self.frame.dim)

    def end_member(self, index: tuple[int, ...]) -> None:
        """Take no more steps of one trajectory, or leave a member where it is."""
        if isinstance(self.rhs, PythonRhs):
            self.rhs.ended[index] = True
            self._run.forget(0)
        elif self.trajectories > 1:
            self._run.finish(int(np.ravel_multi_index(index, self.batch)))
