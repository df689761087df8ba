"""What is kept of the steps of an integration."""

from __future__ import annotations

import numpy as np

from cg.frames.base import Array, Points
from cg.integration.dense import DenseOutput, Segment
from cg.integration.events import EventLog
from cg.integration.result import Solution
from cg.integration.step import Step


class Output:
    """What is kept of the steps of an integration.

    Parameters
    ----------
    step
        The step function.
    t, point
        Where the integration begins.
    wanted
        Times at which to keep the solution, or None to keep every step.
    dense
        Whether to keep a continuous solution.
    log
        The events to look for.
    """

    def __init__(
        self,
        step: Step,
        t: float,
        point: Points,
        wanted: Array | None,
        dense: bool,
        log: EventLog,
    ) -> None:
        self.step = step
        self.wanted = wanted
        self.dense = dense
        self.log = log
        self.start = point
        self.last = t, point
        self.steps = 0
        self.ends = [t]
        self.segments: list[Segment] = []
        self.t = [np.array([t])]
        self.y = [point[None]]
        self.used = 0
        if wanted is not None:
            self.used = int((wanted == t).sum())
            self.t = [wanted[: self.used]]
            self.y = [np.repeat(point[None], self.used, axis=0)]
        log.start(t, point)

    def add(self, t: float, point: Points) -> bool:
        """Keep one step; return whether an event ends the integration in it."""
        self.steps += 1
        segment: Segment | None = None
        terminal = None
        before, self.last = self.last, (t, point)
        if self.dense or self.log:
            segment = Segment(self.step, *before, t, point)
            terminal = self.log.record(segment)
            if terminal is not None:
                t, point = terminal, segment(np.array([terminal]))[0]
        if self.dense and segment is not None:
            self.segments.append(segment)
            self.ends.append(t)
        if self.wanted is None:
            self.t.append(np.array([t]))
            self.y.append(point[None])
        else:
            # Sorted in the direction of integration, so that those reached come first.
            rest = self.wanted[self.used :]
            reached = rest[: int(((rest - t) * np.sign(t - before[0]) <= 0.0).sum())]
            if len(reached) == 1 and reached[0] == t:
                self.t.append(reached)
                self.y.append(point[None])
            elif len(reached):
                segment = segment or Segment(self.step, *before, *self.last)
                self.t.append(reached)
                self.y.append(segment(reached))
            self.used += len(reached)
        return terminal is not None

    def solution(self, status: int, message: str, rejected: int) -> Solution:
        """Return the result."""
        t, y = np.concatenate(self.t), np.concatenate(self.y)
        t.flags.writeable = y.flags.writeable = False
        dense = DenseOutput(self.ends, self.segments, self.start) if self.dense else None
        return Solution(
            t=t,
            y=y,
            sol=dense,
            t_events=self.log.times(),
            y_events=self.log.points(self.start),
            nfev=self.step.nfev,
            njev=self.step.njev,
            nlu=self.step.nlu,
            nexp=self.step.nexp,
            steps=self.steps,
            nrejected=rejected,
            status=status,
            message=message,
            success=status >= 0,
            method=self.step.tableau,
        )
