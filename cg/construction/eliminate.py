"""Eliminate stages and flows along the solution set.

A stage or a flow is dropped, and the conditions are solved again from the remaining coefficients;
or the coefficients of a stage shrink to zero.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from cg.construction.candidate import Candidate, correct, solved
from cg.construction.search.shapes import fixed_weights, merge_point
from cg.construction.solvers.singular import finish
from cg.construction.solvers.system import ConditionSystem, Structure

_LAST_FRACTION = 1e-2  # part of the column; below it the next step goes to zero
_MIN_STEP = 2e-3
_MAX_COLUMNS = 3  # number of columns to try from one candidate
_BUDGET = 1000  # steps of the solver to eliminate one stage
_INTERMEDIATE = 1e-19  # sum of squares that intermediate points must reach

_SPREAD = 0.6  # standard deviation of the order of starts, in logarithms of f
_TRIES = 16  # starts to solve from

Accept = Callable[[Candidate], bool]


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


def fixed_entries(system: ConditionSystem) -> list[int]:
    """Return the entries to hold fixed while solving from a point that isn't a solution.

    In tableaux a_21 is held. With c_2 = ε, c_3 ~ ε^(1/2), c_4 ~ ε^(1/4) and so on, C(2) holds at
    all stages as ε tends to zero: f falls below 1e-18 there, but has no zero.
    """
    if system.rows is None:
        return fixed_weights(system.order, system.layout)
    return [0] if system.order >= 5 and system.stages > 1 else []


def solve_start(candidate: Candidate, iterations: int, *, promising: float) -> Candidate:
    """Solve from a start, and again if f is at most `promising` after the first run."""
    system, frozen = candidate.system, fixed_entries(candidate.system)
    first = correct(
        candidate, frozen, ftol=1e-27, damping=1e-2, max_iterations=iterations, accurate=False
    )
    if not 1e-26 < first.f <= promising:
        return first
    if system.rows is None:
        return Candidate(system, finish(system, first.x, system.movable_without(frozen))[0])
    return correct(
        first, frozen, ftol=1e-27, damping=1e-15, max_iterations=iterations, accurate=True
    )


def drop_stage(
    candidate: Candidate,
    random: np.random.Generator,
    *,
    largest: float = 4.0,
    accept: Accept = solved,
) -> Candidate | None:
    """Drop a stage of a tableau, not of a pair, and solve again; None if no start leads to one.

    The column of the stage is added to that of a neighbour, or dropped.
    """
    starts = list(_without_column(candidate))
    return _first_solved(starts, random, largest, accept, iterations=200, promising=1e-14)


def drop_flow(
    candidate: Candidate,
    random: np.random.Generator,
    *,
    largest: float = 4.0,
    accept: Accept = solved,
) -> Candidate | None:
    """Drop a point of a tree that is neither a stage nor a result, like `drop_stage`."""
    layout = candidate.system.layout
    merged = (
        merge_point(layout, candidate.x.tolist(), m)
        for m in range(len(layout.parents))
        if m not in layout.ends
    )
    starts = [
        Candidate(replace(candidate.system, layout=smaller), x)
        for smaller, x in merged
        if len(set(smaller.stage_of.tolist())) == smaller.stages
    ]
    return _first_solved(starts, random, largest, accept, iterations=400, promising=1e-10)


def _first_solved(
    starts: Sequence[Candidate],
    random: np.random.Generator,
    largest: float,
    accept: Accept,
    *,
    iterations: int,
    promising: float,
) -> Candidate | None:
    """Solve from starts until one leads to an acceptable candidate; None if none does."""
    if not starts:
        return None
    closeness = np.log([max(start.f, 1e-300) for start in starts])
    order = np.argsort(closeness + _SPREAD * random.standard_normal(len(starts)), kind="stable")
    for k in order[:_TRIES]:
        smaller = solve_start(starts[k], iterations, promising=promising)
        if solved(smaller) and smaller.largest <= largest and accept(smaller):
            return smaller
    return None


def _without_column(candidate: Candidate) -> Iterator[Candidate]:
    """Yield the starts without each stage, its column dropped or added to a neighbour."""
    system = candidate.system
    # a structure treats stages 1 and 2 differently
    first = 0 if system.structure is Structure.GENERAL else 2
    if system.stages - 1 < first + 1:
        return
    stages = range(first, system.stages)
    for stage, receiver in [(k, near) for k in stages for near in (None, k - 1, k + 1)]:
        if receiver is not None and receiver not in stages:
            continue
        x = candidate.x.copy()
        for row in map(system.layout.row, range(len(system.layout.ends))):
            if receiver is not None and len(row) > max(stage, receiver):
                x[row[receiver]] += candidate.x[row[stage]]
        x[system.layout.column(stage)] = 0.0
        smaller = Candidate(system, x).without(stage)
        start = np.zeros(smaller.system.size)
        start[smaller.system.movable] = smaller.x[smaller.system.movable]
        yield Candidate(smaller.system, start)
