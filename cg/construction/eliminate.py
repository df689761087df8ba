"""Eliminate stages: drop them, or shrink their coefficients to zero along the solution set."""

from collections.abc import Iterator

import numpy as np

from cg.construction.candidate import Candidate, correct, solved
from cg.construction.drop import Accept, drop_stage, fixed_entries
from cg.construction.solvers.system import Structure

_LAST_FRACTION = 1e-2  # part of the column; below it the next step goes to zero
_MIN_STEP = 2e-3
_MAX_COLUMNS = 3  # number of columns to try from one candidate
_BUDGET = 1000  # steps of the solver to eliminate one stage
_INTERMEDIATE = 1e-19  # sum of squares that intermediate points must reach


def eliminate_stage(candidate: Candidate, stage: int, *, largest: float = 4.0) -> Candidate | None:
    """Eliminate one stage (from 0) of a candidate on the solution set; None if a step fails.

    Its column of ``a`` and its weight shrink to zero together, the other coefficients follow along
    the set. Steps that fail are halved.
    """
    column = candidate.system.layout.column(stage)
    target = candidate.x[column].copy()
    left, step, used = 1.0, 0.2, 0
    while left > 0:
        target_left = left - step if left - step > _LAST_FRACTION else 0.0
        x = candidate.x.copy()
        x[column] = target_left * target
        last = target_left == 0
        iterations = 300 if last else 30
        trial = correct(
            Candidate(candidate.system, x),
            column,
            ftol=1e-26 if last else 1e-22,
            max_iterations=iterations,
        )
        used += iterations if last else 10
        good = solved(trial) if last else trial.f <= _INTERMEDIATE
        if good and trial.largest <= largest:
            candidate, left, step = trial, target_left, min(1.5 * step, 0.5)
            continue
        step /= 2
        if step < _MIN_STEP or used > _BUDGET:
            return None
    return candidate.without(stage)


def walk(
    candidate: Candidate, random: np.random.Generator, *, size: float = 0.3, largest: float = 4.0
) -> Candidate:
    """Return another point of the solution set, after a random step of length `size`."""
    for _ in range(6):
        movable = candidate.system.movable
        x = candidate.x.copy()
        x[movable] += size / np.sqrt(movable.size) * random.standard_normal(movable.size)
        moved = correct(Candidate(candidate.system, x), fixed_entries(candidate.system))
        if solved(moved) and moved.largest <= largest:
            return moved
        size /= 2
    return candidate


def eliminate(
    candidate: Candidate,
    stages: int,
    *,
    random: np.random.Generator,
    largest: float = 4.0,
    restarts: int = 3,
    accept: Accept = lambda candidate: True,
) -> Iterator[Candidate]:
    """Eliminate one stage after another until `stages` are left, and yield each candidate.

    Stages are dropped (`drop_stage`). Of pairs, and after `restarts` walks along the solution set
    without success, columns are shrunk to zero (`eliminate_stage`). `accept` tests candidates.
    """
    stuck = 0
    while candidate.system.stages > stages:
        smaller = None
        pair = candidate.system.layout.pair
        if not pair:
            smaller = drop_stage(candidate, random, largest=largest, accept=accept)
        if smaller is None and (pair or stuck == restarts):
            smaller = _shrink_one(candidate, random, largest, accept)
        if smaller is None:
            stuck += 1
            if stuck > restarts:
                return
            candidate = walk(candidate, random, largest=largest)
        else:
            candidate, stuck = smaller, 0
            yield candidate


def _shrink_one(
    candidate: Candidate, random: np.random.Generator, largest: float, accept: Accept
) -> Candidate | None:
    first = 0 if candidate.system.structure is Structure.GENERAL else 2
    stages = range(first, candidate.system.stages)
    sizes = np.array(
        [np.linalg.norm(candidate.x[candidate.system.layout.column(k)]) for k in stages]
    )
    order = np.argsort(sizes * np.exp(0.4 * random.standard_normal(sizes.size)))
    for k in order[:_MAX_COLUMNS]:
        smaller = eliminate_stage(candidate, stages[int(k)], largest=largest)
        if smaller is not None and accept(smaller):
            return smaller
    return None
