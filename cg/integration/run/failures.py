"""Why trajectories ended before their final time."""

from __future__ import annotations

import math

import numpy as np

from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.integration.arguments import STAGE_SOLVERS
from cg.integration.errors import ConvergenceError, StepTooLongError
from cg.integration.run.drive import find_difficulty
from cg.integration.run.run import Run
from cg.support.checks import short
from cg.support.shared_numbers import STEP_CONTROL, LoopStatus
from cg.tables import Kind

_REQUESTS = {LoopStatus.NEEDS_RHS, LoopStatus.NEEDS_EVENTS, LoopStatus.NEEDS_MAXIMUM}
_ENDED = {LoopStatus.FINISHED, LoopStatus.TERMINAL_EVENT}
_NOT_FAILED = _REQUESTS | _ENDED | {LoopStatus.NO_STOP, LoopStatus.PAUSED}
_REJECTIONS = 1000  # least number of rejected steps for a warning
_LARGE = 1e100  # errors overflow because of slopes beyond this
_NO_FORCES = "there are no forces that keep joints closed"


def failures_of(run: Run, raising: bool) -> dict[int, str]:
    """Return why members failed, by their numbers; raise exceptions if ``raising``.

    MemoryError is raised in any case.
    """
    messages = {}
    for member, status in enumerate(run.status.tolist()):
        if status not in _NOT_FAILED:
            failure = _explain_failure(run, member)
            if isinstance(failure, Exception) and (raising or isinstance(failure, MemoryError)):
                raise failure
            messages[member] = str(failure).removesuffix(".")
    return messages


def _explain_failure(run: Run, member: int) -> Exception | str:
    """Return why a member failed: an exception, or a message.

    It is a message where adaptive steps failed, or ``f`` isn't finite after the start.
    """
    status, flag = LoopStatus(run.status[member]), int(run.detail[member])
    t = float(run.state("failed_at")[member])
    match status:
        case LoopStatus.STEP_TOO_SMALL | LoopStatus.TIME_NOT_FINITE:
            return _explain_step_failure(run, member, t)
        case LoopStatus.TOO_MANY_STEPS:
            steps, difficulty = run.control.max_steps, find_difficulty(run, member, t)
            reason = f"; {difficulty}" if difficulty else ""
            return (
                f"{steps} steps (max_steps), rejected ones included, led only to t = {t:.17g}"
                f"{reason}"
            )
        case LoopStatus.JUMPS_WITHOUT_PROGRESS:
            return f"jumps of events follow each other without progress at t = {t:.17g}"
        case LoopStatus.RESTING_CONTACT:
            return (
                f"the jump of events[{flag - 1}] leaves its function at zero at t = {t:.17g}, and "
                "f doesn't move it off, as where a contact rests: continue from there with f of "
                "the contact; if the solution shall pass, let the jump move it past the zero"
            )
    error = _exception(run, status, member, t, flag)
    return str(error) if status is LoopStatus.RHS_NOT_FINITE and t != run.t0 else error


def _exception(run: Run, status: LoopStatus, member: int, t: float, flag: int) -> Exception:
    """Return the exception for an integration that failed at time ``t``."""
    where, name = f"at t = {t:.17g}", run.rhs.failed_name(member)
    error: Exception
    match status:
        case LoopStatus.STAGES_NOT_SOLVED:
            error = _convergence_error(run, t, flag)
        case LoopStatus.SLOPE_NOT_FINITE:
            error = _first_step_error(run, member, t)
        case LoopStatus.STOPPED_BY_RHS:
            error = RuntimeError(f"{name} returned the error code {flag} {where}")
        case LoopStatus.RHS_NOT_FINITE:
            kind = OverflowError if name is None else ValueError
            error = kind(f"{_not_finite(run, member)}{_got(run, member, t)} {where}")
        case LoopStatus.STAGE_NOT_FINITE:
            reason = f"a stage is no longer finite {where}"
            error = OverflowError(str(run.callbacks.last_error or reason))
        case LoopStatus.STEP_TOO_LONG | LoopStatus.STEP_TOO_LONG_FOR_EVENTS:
            error = StepTooLongError(t, status is LoopStatus.STEP_TOO_LONG_FOR_EVENTS)
        case LoopStatus.JOINTS_NOT_SOLVED:
            error = ArithmeticError(
                f"{_NO_FORCES} {where}: the step is too long, or their constraints depend on each "
                "other there"
            )
        case LoopStatus.SOLUTION_NOT_FINITE:
            error = OverflowError(f"the solution is no longer finite {where}")
        case LoopStatus.OUT_OF_MEMORY:
            error = MemoryError(
                "there is not enough memory for the stages, or the events, of one step"
            )
        case _:
            error = RuntimeError(f"compiled code ended with the unexpected {status!r} {where}")
    return error


def _convergence_error(run: Run, t: float, iterations: int) -> ConvergenceError:
    """Return the exception for stage equations that weren't solved."""
    collocates = run.plan.step_table.kind is Kind.COLLOCATION
    slow = not collocates and iterations in STAGE_SOLVERS.values()
    residual = math.nan if collocates or run.members > 1 else run.record.residual
    reason = "it is too slow" if slow else "it diverges"
    return ConvergenceError(reason, iterations, residual, t, run.record.step_size)


def _first_step_error(run: Run, member: int, t: float) -> Exception:
    """Return the exception for a first step that couldn't be chosen."""
    point = run.plan.points(run.end[member], ())
    slope = run.rhs.at_member(member, t, point)
    if run.control.atol.all() or not np.abs(slope).max() < _LARGE:
        return OverflowError(f"f is too large to choose a step at t = {t:.17g}, got {slope}")
    return ValueError(
        f"atol must be positive for coordinates that are zero, got 0 at t = {t:.17g}, y = {point}"
    )


def _not_finite(run: Run, member: int) -> str:
    """Return the message for a function that returned NaN or infinity."""
    name = run.rhs.failed_name(member)
    if name is None:
        return "derivatives of the solution exceed the range of floating point"
    return f"{name} must return finite numbers{' and write each of them' * run.rhs.writes_results}"


def _got(run: Run, member: int, t: float) -> str:
    """Return the result of ``f`` at the start, since the points of later stages are unknown."""
    if t != run.t0 or run.problem.split_solution is not None:  # a result would hold derivatives
        return ""
    value = run.rhs.result(member, t, run.plan.points(run.end[member].copy(), ()))
    return "" if np.isfinite(value).all() else f", got {short(value)}"


def _explain_step_failure(run: Run, member: int, t: float) -> str:
    """Return the message for a step size that became too small, or leads beyond all numbers."""
    if run.status[member] == LoopStatus.TIME_NOT_FINITE:
        return f"there was no terminal event up to t = {t:.17g}, where floating point ends"
    frame, min_size = run.plan.frame, STEP_CONTROL["min_step"] * math.ulp(t)
    point = run.plan.points(run.end[member].copy(), ())
    try:
        slope, ahead = run.rhs.at_member(member, t, point), 8.0 * min_size * run.problem.direction
        moved = frame.flow(ahead * slope, point)
        is_finite = bool(np.isfinite(moved).all())
        if is_finite and not np.isfinite(run.rhs.at_member(member, t + ahead, moved)).all():
            reason = _not_finite(run, member)
            if frame.jointed:
                force = run.rhs.result(member, t + ahead, moved)
                reason = _NO_FORCES if np.isfinite(force).all() else reason
            return f"{reason} next to t = {t:.17g}, however small the step"
    except (ValueError, ArithmeticError, RuntimeError):
        is_finite = True
    if is_finite:
        return f"the step size fell below {min_size:.3g}, the resolution of time, at t = {t:.17g}"
    return f"the flow of {frame!r} returned NaN or infinity at t = {t:.17g}, however small the step"


def warnings_of(run: Run) -> list[str]:
    """Return the texts of the warnings about a finished run."""
    plan, texts = run.plan, []
    if not run.problem.ensemble:
        *_, steps, rejected = run.counts[0].tolist()
        are_many = rejected >= _REJECTIONS and 2 * rejected > steps
        if are_many and run.status[0] != LoopStatus.TOO_MANY_STEPS:  # which names the reason
            texts.append(
                f"{rejected} steps were rejected beside {steps} accepted ones: if f has kinks or "
                "jumps at known times, name them as breakpoints"
            )
    texts += dropped_parts(run)
    if not plan.is_small(run.record.distance):
        points = plan.points(np.ascontiguousarray(run.end), (run.members,))
        points = points[np.isfinite(points).reshape(len(points), -1).all(axis=1)]
        distances = plan.frame.relative_error(points) if len(points) else np.zeros(0)
        # regular matrices without accurate digits are infinitely far
        distance = float(distances[np.isfinite(distances)].max(initial=0.0))
        if distance > MEMBERSHIP_TOLERANCE:
            texts.append(
                f"the solution has left the manifold: its relative distance at the end is "
                f"{distance:.3g}, more than {MEMBERSHIP_TOLERANCE:.3g}; a restore of the frame "
                "would keep it there, and cg.frames.check(frame) tells whether its flows do"
            )
    return texts


def dropped_parts(run: Run) -> list[str]:
    """Return a warning if a part of derivatives has been dropped, and report no others."""
    record, share = run.record, run.record.dropped
    record.dropped = math.inf if share else 0.0
    if not share or math.isinf(share):
        return []
    return [
        f"f returns derivatives with a part that the fields of {run.plan.user_frame!r} don't have, "
        f"which is dropped: up to {100 * share:.3g} % of their length, at t = "
        f"{record.dropped_at:.17g}"
    ]
