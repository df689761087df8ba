"""The integration of some members in one thread, or of a single point."""

from __future__ import annotations

import math

import numpy as np

from cg.integration.arguments import equal_steps
from cg.integration.errors import TERMINAL_EVENT
from cg.integration.mechanics import refuse_friction
from cg.integration.member_results import MemberResults
from cg.integration.options import Options
from cg.integration.problem import Problem
from cg.integration.run.drive import Progress, drive
from cg.integration.run.failures import failures_of, warnings_of
from cg.integration.run.run import Run
from cg.support.memory import total_memory
from cg.support.shared_numbers import LoopStatus

_TERMINAL = int(LoopStatus.TERMINAL_EVENT)


def add_derivatives(problem: Problem, options: Options | None) -> Problem:
    """Return the problem whose solution has the derivatives that options ask for."""
    if options is None or options["derivatives"] is None:
        return problem
    # an import that takes long
    from cg.integration.derivatives.variational_problem import with_derivatives

    return with_derivatives(problem, options)


def check_output_size(problem: Problem) -> None:
    """Raise ValueError if the output of equal steps needs more memory than the machine has."""
    plan, h = problem.plan, problem.control.h
    if h is None or problem.step_function is not None:
        return
    steps = equal_steps(h, [problem.t0, *problem.segment_ends.tolist()])
    total, needed = steps * len(problem.points), 0
    if problem.every and problem.keeps_points:
        needed = (total // problem.every + 2) * (8 * plan.width + 8)
    if problem.dense_output:
        needed += total * 8 * (2 * plan.width + plan.interpolant_vectors * plan.dim + 5)
    if needed > total_memory():
        raise ValueError(
            f"h must be larger for t_span: {total} steps need {needed / 2**30:.3g} GiB of memory, "
            f"and there are {total_memory() / 2**30:.3g} GiB, got {h!r}"
        )


def integrate_members(problem: Problem, progress: Progress | None) -> MemberResults:
    """Integrate members in this thread."""
    plan, times, members = problem.plan, problem.t_eval, len(problem.points)
    y, observed = None, None
    if times is not None:
        if problem.keeps_points:
            y = np.full((len(times), members, plan.width), math.nan)
        if problem.observer is not None:
            observed = np.full((len(times), members, problem.observer.count), math.nan)
    run = Run(problem, y=y, observed=observed)
    texts: list[str] = []
    drive(run, None if progress is None else progress.update, texts.append)
    messages, status = failures_of(run, not problem.ensemble), np.zeros(members, dtype=np.int64)
    if messages:
        status[list(messages)] = -1
    for member in [k for k, each in enumerate(run.status.tolist()) if each == _TERMINAL]:
        messages[member], status[member] = TERMINAL_EVENT, 1
    if times is None:
        times, y, observed = run.steps()
    shape = len(times), members
    points = plan.points(y, shape) if y is not None else None
    if points is not None:
        refuse_friction(plan, problem.rhs, times, points, run.counts[:, 0])
    if observed is not None and problem.observer is not None:
        observed = observed.reshape(*shape, *problem.observer.shape)
    return MemberResults(
        times, points, observed, run.reached, status, run.counts, messages,
        run.interpolants() if problem.dense_output else None,
        None if problem.events is None else run.events(), texts + warnings_of(run),
    )  # fmt: skip
