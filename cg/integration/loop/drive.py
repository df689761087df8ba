"""Advancing a run to its end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cg.integration.loop.run import Run
from cg.integration.loop.step_budget import StepBudget
from cg.integration.loop.stiffness import StepCheck
from cg.support.parallel import raise_if_stopped


def drive(run: Run, watch: Callable[[float], None] | None = None) -> None:
    """Advance all members to their ends; ``watch`` gets the time covered by all together."""
    budget, record, check = StepBudget(), run.record, None
    while True:
        given = budget.start()
        if check is not None:
            given = min(given, check.steps_left())
        record.budget = given
        run.call()
        raise_if_stopped()
        if watch is not None:
            watch(float(np.abs(run.reached - run.t0).sum()))
        if record.ended == run.members:
            return
        check = check or StepCheck(run)
        budget.stop(max(given - record.budget, 1))
        check.update(given - record.budget)
