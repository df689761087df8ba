"""Events of a stepper."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cg.frames.arrays import Array, Points
from cg.support.shared_numbers import Stop


class FoundEvents(NamedTuple):
    """Events: which ones, their times, and the points before and after jumps."""

    of: Any
    t: Array
    before: Points
    after: Points


def collect_events(stepper: Any) -> bool:
    """Move the events of a run to its stepper; return whether the last one ended a step."""
    run = stepper._run
    if not run._events:
        return False
    of, t, y = run.events()
    run._events.clear()
    stepper._found.append(FoundEvents(of[:, 1], t, y[:, 0], y[:, 1]))
    ends = run.status[0] == Stop.TERMINAL_EVENT or run.problem.events.rows[of[:, 1], 4].any()
    return bool(ends and t[-1] == run.reached[0])


def event_lists(stepper: Any, name: str) -> list[Array] | None:
    """Return an array for each event of a stepper, None without events."""
    table = stepper._problem.events
    if table is None:
        return None
    frame, found = stepper.frame, stepper._found
    shape, kind = ((0,), np.float64) if name == "t" else ((0, *frame.point_shape), frame.dtype)
    return [
        np.concatenate([np.empty(shape, kind), *(getattr(f, name)[f.of == i] for f in found)])
        for i in range(len(table))
    ]
