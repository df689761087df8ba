"""Drop a stage or a flow, then solve again from the remaining coefficients."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from cg.construction.candidate import Candidate, correct, solved
from cg.construction.search.shapes import fixed_weights, merge_point
from cg.construction.solvers.singular import finish
from cg.construction.solvers.system import ConditionSystem, Structure

_SPREAD = 0.6  # standard deviation of the order of starts, in logarithms of f
_TRIES = 16  # starts to solve from

Accept = Callable[[Candidate], bool]


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
