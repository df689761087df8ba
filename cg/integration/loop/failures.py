"""Why trajectories ended before their final time."""

from __future__ import annotations

import math

import numpy as np

from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.integration.loop.messages import (
    DERIVATIVES,
    FLOW_NOT_FINITE,
    LEFT_MANIFOLD,
    LONG_STEPS,
    MANY_REJECTIONS,
    MAX_STEPS,
    NO_PROGRESS,
    RESTS,
    STEP_TOO_SMALL,
    ZERO_TOLERANCE,
    StageOverflowError,
    StepTooLongError,
)
from cg.integration.loop.record import COUNTS
from cg.integration.loop.run import Run
from cg.integration.loop.stiffness import find_difficulty
from cg.integration.step.implicit import STAGE_SOLVERS, ConvergenceError
from cg.integration.step.plan import has_brackets
from cg.support.shared_numbers import Stop

_REJECTIONS = 1000  # more than the accepted steps, beyond which there is a warning
_SHORT = 1.0  # length of coefficients that no frame has beyond the radius of dexp⁻¹
_MAX_DIM = 1000  # larger frames would need much memory for the check of the length of steps
_LARGE = 1e100  # slopes beyond this are the reason for errors that overflow


def explain_failure(run: Run, member: int) -> Exception | str | None:
    """Return why a member ended early: an exception, or a message for failed adaptive steps."""
    stop, t, flag = Stop(run.status[member]), float(run.failed_at[member]), int(run.flag[member])
    match stop:
        case Stop.FINISHED | Stop.PAUSED | Stop.TERMINAL_EVENT:
            return None
        case Stop.STEP_TOO_SMALL:
            return _explain_step_failure(run, member, t)
        case Stop.TOO_MANY_STEPS:
            return _explain_number_of_steps(run, member, t)
        case Stop.JUMPS_WITHOUT_PROGRESS:
            return NO_PROGRESS.format(t=t)
        case Stop.RESTING_CONTACT:
            return RESTS.format(event=flag - 1, t=t)
    return _exception(run, stop, member, t, flag)


def _exception(run: Run, stop: Stop, member: int, t: float, flag: int) -> Exception:
    """Return the exception for an integration that failed at time ``t``."""
    where, name = f"at t = {t:.17g}", run.rhs.failed_name
    error: Exception = MemoryError("there is not enough memory for the stages of one step")
    match stop:
        case Stop.STAGES_NOT_SOLVED:
            slow = not run.plan.collocation and flag in STAGE_SOLVERS.values()
            residual = math.nan if run.plan.collocation else run.record.residual
            reason = "it is too slow" if slow else "it diverges"
            error = ConvergenceError(reason, flag, residual, t, run.record.step_size)
        case Stop.SLOPE_NOT_FINITE:
            point = run.plan.points(run.end[member], ())
            slope = run.rhs.at_member(member, t, point)
            error = OverflowError(f"f is too large to choose a step {where}, got {slope}")
            if not run.control.atol.all() and np.abs(slope).max() < _LARGE:
                error = ValueError(ZERO_TOLERANCE.format(t=t, point=point))
        case Stop.STOPPED_BY_FIELD:
            error = RuntimeError(f"{name} returned the error code {flag} {where}")
        case Stop.FIELD_NOT_FINITE if name == DERIVATIVES:
            error = OverflowError(f"{name} exceed the range of floating point {where}")
        case Stop.FIELD_NOT_FINITE:
            error = ValueError(f"{name} must return finite numbers, and all of them, {where}")
        case Stop.STAGE_NOT_FINITE:
            reason = f"a stage is no longer finite {where}"
            error = StageOverflowError(str(run.callbacks.last_error or reason))
        case Stop.STEP_TOO_LONG:
            error = StepTooLongError(t)
        case Stop.SOLUTION_NOT_FINITE:
            error = OverflowError(f"the solution is no longer finite {where}")
    return error


def _explain_number_of_steps(run: Run, member: int, t: float) -> str:
    limit, rejected = run.control.max_steps, int(run.counts[member, COUNTS.index("nrejected")])
    reason = f"; {rejected} of them were rejected" if 2 * rejected > limit // 10 else ""
    if difficulty := find_difficulty(run, member, t):
        reason += f"; {difficulty}"
    return MAX_STEPS.format(steps=limit, t=t, reason=reason)


def _explain_step_failure(run: Run, member: int, t: float) -> str:
    """Return the message for a step size that became too small."""
    plan, message = run.plan, STEP_TOO_SMALL.format(smallest=10.0 * math.ulp(t), t=t)
    point = plan.points(run.end[member].copy(), ())
    try:
        slope = run.rhs.at_member(member, t, point)
        moved = plan.frame.flow(run.record.step_size * slope, point)
    except (ValueError, ArithmeticError, RuntimeError):
        return message
    if np.isfinite(moved).all():
        return message
    return FLOW_NOT_FINITE.format(frame=plan.frame, t=t)


def find_mistakes(run: Run) -> list[str]:
    """Return warnings that a finished run gives rise to."""
    plan, h, texts = run.plan, run.control.h, []
    if not run.problem.many:
        *_, steps, rejected = run.counts[0].tolist()
        many = rejected >= _REJECTIONS and 2 * rejected > steps
        if many and run.status[0] != Stop.TOO_MANY_STEPS:  # whose message names the reason
            texts.append(MANY_REJECTIONS.format(steps=steps, nrejected=rejected))
        if h is not None and steps and takes_long_steps(run):
            texts.append(LONG_STEPS.format(h=h))
    if not plan.surely_on_manifold(run.end):
        points = plan.points(np.ascontiguousarray(run.end), (run.members,))
        finite = np.isfinite(points).reshape(len(points), -1).all(axis=1)
        distance = plan.distance_from_manifold(points if finite.all() else points[finite])
        if distance is not None:
            texts.append(LEFT_MANIFOLD.format(distance=distance, tolerance=MEMBERSHIP_TOLERANCE))
    return texts


def takes_long_steps(run: Run) -> bool:
    """Return whether the last step of a single trajectory was far too long.

    Then coefficients differ between its stages by more than the radius of dexp⁻¹. For rotations
    the radius is a full turn. Coefficients that commute have none, and those that the stages have
    in common don't matter: flows along them are exact.
    """
    frame = run.plan.frame
    if frame.dim > _MAX_DIM:
        return False
    stages = run.last_stages()
    change = stages - stages[0]
    if not np.square(change).sum(axis=1).max() > _SHORT or not has_brackets(frame):
        return False
    return not np.isfinite(frame.dexpinv(change, stages)).all()
