"""Drop a stage of a tableau, then solve again from the remaining coefficients."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..support.checks import check_generator, check_integer, check_real
from .candidate import Candidate, check_candidate, correct, movable, solved
from .search.shapes import held_weights
from .solvers.singular import finish
from .solvers.system import ConditionSystem, Structure

__all__ = ["drop_stage", "first_solved", "held", "solve_start"]

_SPREAD = 0.6  # standard deviation of the order of starts, in logarithms of f
_PROMISING = 1e-14  # sum of squares from which on the solver goes on after a stage was dropped


def held(system: ConditionSystem) -> list[int]:
    """Return the entries to hold fixed while solving from a point that isn't a solution.

    This keeps the solver away from a degenerate limit at a_21 = 0: with c_2 = ε, c_3 ~ ε^(1/2),
    c_4 ~ ε^(1/4) and so on, C(2) holds at all stages as ε tends to zero, and f falls below 1e-18
    but has no zero.
    """
    if system.rows is None:
        return held_weights(system.order, system.layout)
    return [0] if system.order >= 5 and system.stages > 1 else []


def solve_start(candidate: Candidate, iterations: int, *, promising: float) -> Candidate:
    """Solve from a start, a second time if f is at most `promising` after the first run."""
    frozen = held(candidate.system)
    options: dict[str, Any] = {"ftol": 1e-27, "max_iterations": iterations}
    first = correct(candidate, frozen, damping=1e-2, accurate=False, **options)
    if not 1e-26 < first.f <= promising:
        return first
    if candidate.system.rows is None:
        free = movable(candidate.system, frozen)
        x, _ = finish(candidate.system, first.x, free)
        return Candidate(candidate.system, x)
    return correct(first, frozen, damping=1e-15, accurate=True, **options)


def drop_stage(
    candidate: Candidate,
    random: np.random.Generator,
    *,
    largest: float = 4.0,
    tries: int = 16,
    iterations: int = 200,
    accept: Callable[[Candidate], bool] = solved,
) -> Candidate | None:
    """Drop a stage and solve again.

    The column of the stage is added to that of a neighbour, or dropped. Starts with the smallest
    sums of squares come first, in a slightly random order.

    Parameters
    ----------
    candidate : Candidate
        On the solution set; not a pair.
    random : numpy.random.Generator
        Source of the order of tries.
    largest : float, optional
        Bound on the magnitude of coefficients.
    tries : int, optional
        How many of the possibilities are tried.
    iterations : int, optional
        Bound on the solver's steps in each, and once more where they lead far down.
    accept : callable, optional
        A further test of the smaller candidate.

    Returns
    -------
    Candidate or None
        A candidate with one stage less, on the solution set; None if all tries failed.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range.
    """
    check_candidate(candidate)
    if candidate.system.embedded:
        raise ValueError("candidate must be one method, got a pair")
    starts = list(_smaller_starts(candidate))
    return first_solved(starts, random, largest, tries, iterations, accept, _PROMISING)


def first_solved(
    starts: Sequence[Candidate],
    random: np.random.Generator,
    largest: float,
    tries: int,
    iterations: int,
    accept: Callable[[Candidate], bool],
    promising: float,
) -> Candidate | None:
    """Solve from starts until one leads to an acceptable candidate; None if none does.

    Starts with the smallest sums of squares come first, in a slightly random order.

    Parameters
    ----------
    starts : sequence of Candidate
    random : numpy.random.Generator
    largest : float
        Bound on the magnitude of coefficients.
    tries : int
        Largest number of starts to solve from.
    iterations, promising : int, float
        As for `solve_start`.
    accept : callable
        A further test of solutions.
    """
    check_generator("random", random)
    tries = check_integer("tries", tries, 1)
    iterations = check_integer("iterations", iterations, 1)
    largest = check_real("largest", largest, positive=True)
    if not starts:
        return None
    closeness = np.log([max(start.f, 1e-300) for start in starts])
    order = np.argsort(closeness + _SPREAD * random.standard_normal(len(starts)), kind="stable")
    for k in order[:tries]:
        smaller = solve_start(starts[k], iterations, promising=promising)
        if solved(smaller) and smaller.largest <= largest and accept(smaller):
            return smaller
    return None


def _smaller_starts(candidate: Candidate) -> Iterator[Candidate]:
    """Yield the starts without each stage, its column dropped or added to a neighbour."""
    system = candidate.system
    # a structure treats stages 1 and 2 differently
    first = 0 if system.structure is Structure.GENERAL else 2
    for stage in range(first, system.stages):
        if system.stages - 1 < first + 1:
            return
        column = candidate.column(stage)
        for receiver in (None, stage - 1, stage + 1):
            x = candidate.x.copy()
            if receiver is not None:
                if not first <= receiver < system.stages:
                    continue
                _add_column(candidate, x, stage, receiver)
            x[column] = 0.0
            smaller = Candidate(system, x).without(stage)
            kept = np.zeros(smaller.system.size)
            kept[smaller.system.free] = smaller.x[smaller.system.free]
            yield Candidate(smaller.system, kept)


def _add_column(candidate: Candidate, x: NDArray[np.float64], stage: int, receiver: int) -> None:
    """Add the column of a stage to that of the receiver, in the rows that have both."""
    layout = candidate.system.layout
    for r in range(len(layout.ends)):
        row = layout.row(r)
        if len(row) > max(stage, receiver):
            x[row[receiver]] += candidate.x[row[stage]]
