"""What compiled code is to do for `cg.solve_ivp`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cg.frames.base import Array, Points
from cg.integration.adaptive import ErrorNorm, error_exponent
from cg.integration.arguments import check_memory
from cg.integration.external import CompiledRhs, check_step_count
from cg.integration.fixed import last_step
from cg.integration.step import Step


@dataclass(frozen=True)
class Task:
    """What every trajectory of a compiled right-hand side is integrated with.

    Attributes
    ----------
    rhs
        The right-hand side.
    step
        The step function of an explicit method.
    stop
        Final time.
    atol
        Absolute tolerances, shape ``(dim,)``.
    limits
        Relative tolerance, exponent of errors and largest step; of given steps where they start,
        their signed size, and that of the last.
    given
        The number of given steps, zero if steps are chosen.
    first_step
        Size of the first step, or None to choose it from the problem.
    max_steps
        Largest number of steps, rejected ones included.
    keep
        Whether to keep all steps.
    dense
        Whether to make a continuous solution.
    """

    rhs: CompiledRhs
    step: Step
    stop: float
    atol: Array
    limits: tuple[float, float, float]
    given: int
    first_step: float | None
    max_steps: int
    keep: bool
    dense: bool


def adaptive_task(
    rhs: CompiledRhs,
    step: Step,
    stop: float,
    norm: ErrorNorm,
    *,
    max_step: float,
    first_step: float | None,
    max_steps: int,
    keep: bool,
    dense: bool,
) -> Task:
    """Return the task of choosing steps by the error estimate of a pair; see `Task`."""
    limits = norm.rtol, error_exponent(step.tableau), max_step
    atol = np.array(np.broadcast_to(norm.atol, step.frame.dim))
    return Task(rhs, step, stop, atol, limits, 0, first_step, max_steps, keep, dense)


def fixed_task(
    rhs: CompiledRhs,
    step: Step,
    span: tuple[float, float],
    steps: int,
    h: float,
    point: Points,
    *,
    keep: bool,
    dense: bool,
) -> Task:
    """Return the task of taking steps of size ``h`` from a point or ensemble; see `Task`.

    Raises
    ------
    ValueError
        If there are more steps than can be counted, or than memory can hold.
    """
    check_step_count(steps)
    size = point.nbytes + point.size // math.prod(step.frame.point_shape) * step.frame.dim * 8
    # they are kept in parts before they are put together
    check_memory(h, 0, 2 * steps * (size + 8) if keep or dense else 0)
    start, stop = span
    size_of_step = last = math.copysign(h, stop - start)
    if steps:
        last = last_step(start + (steps - 1) * size_of_step, stop, size_of_step)
    limits = start, size_of_step, last
    return Task(rhs, step, stop, np.zeros(step.frame.dim), limits, steps, None, steps, keep, dense)
