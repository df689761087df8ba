"""Fewer stages: drop one after the other, or drive one's influence to zero along the set."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ..support.checks import MAX_HALF_WIDTH, check_generator, check_integer, check_real
from .candidate import Candidate, check_candidate, correct, solved
from .drop import drop_stage, held
from .solvers.system import Structure

__all__ = ["eliminate", "eliminate_stage", "walk"]

_NEARLY_GONE = 1e-2  # from this fraction of the column on, the rest is tried at once
_MIN_STEP = 2e-3
_SHRUNK = 3  # columns that are tried from one candidate
_INTERMEDIATE = 1e-19  # sum of squares that is good enough on the way


def eliminate_stage(
    candidate: Candidate, stage: int, *, largest: float = 4.0, budget: int = 1000
) -> Candidate | None:
    """Take one stage out.

    Its column of ``a`` and its weight are shrunk together, in steps that adapt to how
    well all other coefficients follow.

    Parameters
    ----------
    candidate : Candidate
        On the solution set.
    stage : int
        From 0.
    largest : float, optional
        Bound on the magnitude of coefficients on the way.
    budget : int, optional
        Bound on steps of the solver.

    Returns
    -------
    Candidate or None
        With one stage less, on its own solution set; None where the way is blocked.
    """
    check_candidate(candidate)
    stage = check_integer("stage", stage, 0, candidate.system.stages - 1)
    largest = check_real("largest", largest, positive=True)
    budget = check_integer("budget", budget, 1)
    column = candidate.column(stage)
    target = candidate.x[column].copy()
    left, step, used = 1.0, 0.2, 0
    while left > 0:
        wanted = left - step if left - step > _NEARLY_GONE else 0.0
        x = candidate.x.copy()
        x[column] = wanted * target
        last = wanted == 0
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
            candidate, left, step = trial, wanted, min(1.5 * step, 0.5)
            continue
        step /= 2
        if step < _MIN_STEP or used > budget:
            return None
    return candidate.without(stage)


def walk(
    candidate: Candidate, random: np.random.Generator, *, size: float = 0.3, largest: float = 4.0
) -> Candidate:
    """Return another point of the solution set, a random step of this Euclidean length away."""
    check_candidate(candidate)
    check_generator("random", random)
    size = check_real("size", size, most=MAX_HALF_WIDTH)
    largest = check_real("largest", largest, positive=True)
    for _ in range(6):
        free = candidate.system.free
        x = candidate.x.copy()
        x[free] += size / np.sqrt(free.size) * random.standard_normal(free.size)
        moved = correct(Candidate(candidate.system, x), held(candidate.system))
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
    tries: int = 16,
    restarts: int = 3,
    accept: Callable[[Candidate], bool] = lambda candidate: True,
) -> Iterator[Candidate]:
    """Eliminate stage after stage, yielding every candidate on the way down.

    Stages are left out one by one (`drop_stage`). For pairs, and where no stage can be
    left out even after walks along the set, columns are driven to zero (`eliminate_stage`).

    Parameters
    ----------
    candidate : Candidate
        On the solution set.
    stages : int
        Where to stop.
    random : numpy.random.Generator
        Source of the order in which stages are tried, and of the walks.
    largest : float, optional
        Bound on the magnitude of coefficients.
    tries : int, optional
        Ways to drop a stage that are tried from one candidate.
    restarts : int, optional
        Walks to another point of the set after which a dead end is one.
    accept : callable, optional
        A test that a smaller candidate has to pass, for instance on its rank.

    Yields
    ------
    Candidate
        With one stage less than the one before.
    """
    check_candidate(candidate)
    check_generator("random", random)
    stages = check_integer("stages", stages, 1)
    restarts = check_integer("restarts", restarts, 0)
    stuck = 0
    while candidate.system.stages > stages:
        found = None
        if not candidate.system.embedded:
            found = drop_stage(candidate, random, largest=largest, tries=tries, accept=accept)
        if found is None and (candidate.system.embedded or stuck == restarts):
            found = _shrink_one(candidate, random, largest, accept)
        if found is None:
            stuck += 1
            if stuck > restarts:
                return
            candidate = walk(candidate, random, largest=largest)
        else:
            candidate, stuck = found, 0
            yield candidate


def _shrink_one(
    candidate: Candidate,
    random: np.random.Generator,
    largest: float,
    accept: Callable[[Candidate], bool],
) -> Candidate | None:
    first = 0 if candidate.system.structure is Structure.GENERAL else 2
    stages = range(first, candidate.system.stages)
    sizes = np.array([np.linalg.norm(candidate.x[candidate.column(k)]) for k in stages])
    order = np.argsort(sizes * np.exp(0.4 * random.standard_normal(sizes.size)))
    for k in order[:_SHRUNK]:
        smaller = eliminate_stage(candidate, stages[int(k)], largest=largest)
        if smaller is not None and accept(smaller):
            return smaller
    return None
