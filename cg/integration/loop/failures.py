"""Why trajectories ended before their final time."""

from __future__ import annotations

import math

import numpy as np

from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.integration.loop.long_steps import takes_long_steps
from cg.integration.loop.messages import (
    LEFT_MANIFOLD,
    LONG_STEPS,
    MANY_REJECTIONS,
    StageOverflowError,
    failure,
    flow_not_finite,
    no_progress,
    rests,
    too_many_steps,
    too_small_a_step,
    zero_tolerance,
)
from cg.integration.loop.record import COUNTS
from cg.integration.loop.run import Run
from cg.integration.loop.stiffness import find_difficulty
from cg.integration.step.implicit import STAGE_SOLVERS, ConvergenceError
from cg.support.shared_numbers import Stop

_REJECTIONS = 1000  # more than the accepted steps, beyond which there is a warning
_LARGE = 1e100  # slopes beyond this are the reason for errors that overflow


def explain_failure(run: Run, member: int) -> Exception | str | None:  # noqa: PLR0911
    """Return why a member ended early: an exception, or a message for failed adaptive steps."""
    stop, t = Stop(run.status[member]), float(run.failed_at[member])
    match stop:
        case Stop.FINISHED | Stop.PAUSED | Stop.TERMINAL_EVENT:
            return None
        case Stop.STEP_TOO_SMALL:
            return _explain_step_failure(run, member, t)
        case Stop.TOO_MANY_STEPS:
            rejected = int(run.counts[member, COUNTS.index("nrejected")])
            reason = find_difficulty(run, member, t)
            return too_many_steps(run.control.max_steps, t, rejected, reason)
        case Stop.JUMPS_WITHOUT_PROGRESS:
            return no_progress(t)
        case Stop.RESTING_CONTACT:
            return rests(int(run.flag[member]) - 1, t)
        case Stop.STAGES_NOT_SOLVED:
            iterations = int(run.flag[member])
            slow = not run.plan.collocation and iterations in STAGE_SOLVERS.values()
            residual = math.nan if run.plan.collocation else run.record.residual
            reason = "it is too slow" if slow else "it diverges"
            return ConvergenceError(reason, iterations, residual, t, run.record.step_size)
        case Stop.SLOPE_NOT_FINITE:
            point = run.plan.points(run.end[member], ())
            slope = run.rhs.at_member(member, t, point)
            if not run.control.atol.all() and np.abs(slope).max() < _LARGE:
                return ValueError(zero_tolerance(t, point))
            return failure(stop, 0, t, slope)
        case Stop.STAGE_NOT_FINITE if run.callbacks.last_error is not None:
            return StageOverflowError(str(run.callbacks.last_error))
    return failure(stop, int(run.flag[member]), t, name=run.rhs.failed_name)


def _explain_step_failure(run: Run, member: int, t: float) -> str:
    """Return the message for a step size that became too small."""
    plan = run.plan
    point = plan.points(run.end[member].copy(), ())
    try:
        slope = run.rhs.at_member(member, t, point)
        moved = plan.frame.flow(run.record.step_size * slope, point)
    except (ValueError, ArithmeticError, RuntimeError):
        return too_small_a_step(t)
    return too_small_a_step(t) if np.isfinite(moved).all() else flow_not_finite(plan.frame, t)


def find_mistakes(run: Run) -> list[str]:
    """Return warnings that a finished run gives rise to."""
    plan, h, texts = run.plan, run.control.h, []
    if not run.problem.many:
        *_, steps, rejected = run.counts[0].tolist()
        if rejected >= _REJECTIONS and 2 * rejected > steps:
            texts.append(MANY_REJECTIONS.format(steps=steps, nrejected=rejected))
        if h is not None and steps and takes_long_steps(run):
            texts.append(LONG_STEPS.format(h=h))
    rows = np.ascontiguousarray(run.end)
    if not plan.surely_on_manifold(rows):
        points = plan.points(rows, (run.members,))
        finite = np.isfinite(points).reshape(len(points), -1).all(axis=1)
        distance = plan.distance_from_manifold(points if finite.all() else points[finite])
        if distance is not None:
            texts.append(LEFT_MANIFOLD.format(distance=distance, tolerance=MEMBERSHIP_TOLERANCE))
    return texts
