"""What is kept of the steps of an integration: their ends, wanted times, events, all of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.arrays import Array, Points
from cg.integration.dense import DenseOutput
from cg.integration.events import EventLog, point_at
from cg.integration.interpolant import Indices, Interpolant
from cg.integration.interpolation import interpolate
from cg.integration.stepper import Block, Stepper

__all__ = ["Recorder", "steps_of"]

Member = tuple[int, ...]


class Recorder:
    """Turns blocks of steps into what was asked for.

    Parameters
    ----------
    stepper
        Where the blocks come from; they have slopes if anything between steps is asked for.
    t, points
        Where the integration begins; shape ``(*batch, *point_shape)``.
    wanted
        Times at which to keep the solution, or None to keep every step.
    dense
        Whether to keep a continuous solution.
    logs
        The events to look for, of each member of an ensemble by its index; of a single point by
        ``()``.

    Attributes
    ----------
    ended
        When members were ended by an event.
    """

    def __init__(
        self,
        stepper: Stepper,
        t: float,
        points: Points,
        wanted: Array | None,
        dense: bool,
        logs: dict[Member, EventLog],
    ) -> None:
        self.stepper = stepper
        self.start = points
        self.wanted = wanted
        self.dense = dense
        self.logs = dict(logs)
        self.ended: dict[Member, float] = {}
        self.last: Points | None = None
        self.steps = 0
        self.ends = [np.array([t])]
        self.parts: list[Interpolant] = []
        self.used = 0 if wanted is None else int((wanted == t).sum())
        first = 1 if wanted is None else self.used
        self.t = [np.full(first, t)]
        self.y = [np.repeat(points[None], first, axis=0)]
        for member, log in self.logs.items():
            log.start(t, points[member])

    def add(self, block: Block) -> bool:
        """Keep the steps of a block; return whether events end the integration in it."""
        made: dict[int, Interpolant] = {}
        going = set(self.logs)
        stop = self._record_events(block, made)
        if stop is not None:
            block = block.part(stop[0] + 1)
        end = float(block.t[-1]) if stop is None else _time(block, *stop)
        self.steps += len(block)
        rest = np.empty(0) if self.wanted is None else self.wanted[self.used :]
        positions = steps_of(rest, block.t, end)
        inside = [] if self.wanted is None else np.unique(positions[0][positions[1]]).tolist()
        solution = self._solution(block, made, range(len(block)) if self.dense else inside)
        if stop is not None:
            point = block.y[-1] if stop[1] == 1.0 else point_at(made[stop[0]], stop[1])
            t, y = block.t.copy(), block.y.copy()
            t[-1], y[-1] = end, point
            self.last = point
            if self.wanted is None:
                block = Block(t, y, block.slopes)
        if self.wanted is None:
            self._keep(block.t[1:], block.y[1:])
        else:
            self._keep_wanted(block, positions, solution)
        if self.dense:
            assert solution is not None
            self.parts.append(solution[0])
            self.ends.append(np.append(block.t[1:-1], end))
        for member in going.difference(self.logs):  # not before its last step is complete
            self.stepper.end_member(member)
        return stop is not None

    def _record_events(
        self, block: Block, made: dict[int, Interpolant]
    ) -> tuple[int, float] | None:
        """Record events; return the step, and where in it the last member is ended, if all are."""
        if not self.logs:
            return None
        for k in range(len(block)):
            t0, t1 = float(block.t[k]), float(block.t[k + 1])

            def within(k: int = k) -> Interpolant:
                if k not in made:
                    made[k] = interpolate(self.stepper, block, np.array([k]))
                return made[k]

            end = 0.0
            for member in list(self.logs):
                theta = self._record_member(member, t0, t1, block.y[k + 1], within)
                if theta is not None:
                    self.ended[member] = _time(block, k, theta)
                    end = max(end, theta)
                    del self.logs[member]
            if not self.logs:
                return k, end
        return None

    def _record_member(
        self, member: Member, t0: float, t1: float, y1: Points, within: Callable[[], Interpolant]
    ) -> float | None:
        """Record the events of one member in one step."""
        point = y1[member]
        if not np.isfinite(point).all():  # it has failed, and is no more
            return None
        if not member:
            return self.logs[member].record(t0, t1, point, within)
        return self.logs[member].record(t0, t1, point, lambda: within().member(member))

    def _solution(
        self, block: Block, made: dict[int, Interpolant], needed: range | list[int]
    ) -> tuple[Interpolant, NDArray[np.intp]] | None:
        """Return the solution within steps that need it, and the place of each step in it."""
        if not needed:
            return None
        new = [k for k in needed if k not in made]
        parts = [made[k] for k in needed if k in made]
        order = [k for k in needed if k in made]
        if new:
            parts.append(interpolate(self.stepper, block, np.array(new)))
            order += new
        solution = Interpolant.join(parts)
        if order != sorted(order):
            solution = solution.part(np.argsort(order))
        place = np.zeros(len(block), dtype=np.intp)
        place[sorted(order)] = np.arange(len(order))
        return solution, place

    def _keep_wanted(
        self,
        block: Block,
        positions: tuple[NDArray[np.intp], NDArray[np.bool_]],
        solution: tuple[Interpolant, NDArray[np.intp]] | None,
    ) -> None:
        assert self.wanted is not None
        which, inside = positions
        t = self.wanted[self.used : self.used + len(which)]
        self.used += len(which)
        y = block.y[which + 1]
        if inside.any():
            assert solution is not None
            y[inside] = solution[0].at(solution[1][which[inside]], t[inside])
            self.stepper.counts.nexp += int(inside.sum()) * (len(solution[0].flows.weights) + 1)
        self._keep(t, y)

    def _keep(self, t: Array, y: Points) -> None:
        sign = 1.0 if t.size == 0 or t[-1] >= self.ends[0][0] else -1.0
        if any(self.ended):
            y = y.copy()  # the next steps go on from it
        for member, end in self.ended.items():
            if member:
                beyond: Any = (sign * (t - end) > 0.0, *member)
                y[beyond] = math.nan
        self.t.append(t)
        self.y.append(y)

    @property
    def _whole(self) -> tuple[Array, Points] | None:
        """All steps, where they were kept in one piece and that is what is wanted."""
        whole = self.stepper.whole
        return None if self.wanted is not None or self.ended else whole

    def times(self) -> Array:
        """Return the times that were kept, shape ``(n,)``, read-only."""
        t = np.concatenate(self.t) if self._whole is None else self._whole[0]
        t.flags.writeable = False
        return t

    def points(self) -> Points:
        """Return the points at them, shape ``(n, *batch, *point_shape)``, read-only."""
        y: Points = np.concatenate(self.y) if self._whole is None else self._whole[1]
        y.flags.writeable = False
        return y

    def solution(self) -> DenseOutput | None:
        """Return the continuous solution, or None if it wasn't asked for."""
        if not self.dense:
            return None
        joined = Interpolant.join(self.parts) if self.parts else None
        ends = {member: end for member, end in self.ended.items() if member}
        return DenseOutput(np.concatenate(self.ends), joined, self.start, self.last, ends)


def steps_of(rest: Array, t: Array, end: float) -> tuple[Indices, NDArray[np.bool_]]:
    """Return in which steps wanted times up to some end are, and whether they are inside of them.

    Parameters
    ----------
    rest
        The times, in the order of the integration.
    t
        The ends of the steps, shape ``(steps + 1,)``.
    end
        Up to where the steps go.
    """
    sign = 1.0 if t[-1] >= t[0] else -1.0
    times = rest[: int((sign * (rest - end) <= 0.0).sum())]
    which = np.maximum(np.searchsorted(sign * t, sign * times, side="left") - 1, 0)
    return which, times != t[which + 1]


def _time(block: Block, step: int, theta: float) -> float:
    """Return the time at a fraction of a step."""
    t0, t1 = float(block.t[step]), float(block.t[step + 1])
    return t1 if theta == 1.0 else t0 + theta * (t1 - t0)
