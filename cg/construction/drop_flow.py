"""Drop a flow or a stage of a commutator-free method, then solve again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..structure.layout import Layout
from .candidate import Candidate, check_candidate, solved
from .drop import first_solved
from .search.shapes import merge_point, select_points

__all__ = ["drop_flow", "drop_point_stage"]

_PROMISING = 1e-10  # sum of squares from which on the solver goes on after the first run


def drop_flow(
    candidate: Candidate,
    random: np.random.Generator,
    *,
    largest: float = 4.0,
    tries: int = 16,
    iterations: int = 400,
    accept: Callable[[Candidate], bool] = solved,
) -> Candidate | None:
    """Drop a point that is neither a stage nor a result, and solve again.

    Flows that start from the point start from its parent instead, with the sums of the weights of
    both flows. Starts with the smallest sums of squares come first, in a slightly random order.

    Parameters
    ----------
    candidate : Candidate
        A commutator-free method, on the solution set.
    random : numpy.random.Generator
        Determines the order of tries.
    largest : float, optional
        Bound on the magnitude of weights.
    tries : int, optional
        Largest number of starts to solve from.
    iterations : int, optional
        Largest number of steps of the solver in each run.
    accept : callable, optional
        A further test of the smaller candidate.

    Returns
    -------
    Candidate or None
        A candidate with one flow less, on the solution set; None if all tries failed.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range, or the candidate is a tableau.
    """
    layout = _check_points(candidate)
    inner = [m for m in range(len(layout.parents)) if m not in layout.ends]
    system, x = candidate.system, candidate.x.tolist()
    merged = (merge_point(layout, x, m) for m in inner)
    starts = [
        Candidate(replace(system, layout=smaller), start)
        for smaller, start in merged
        if smaller.uses_every_stage
    ]
    return first_solved(starts, random, largest, tries, iterations, accept, _PROMISING)


def drop_point_stage(
    candidate: Candidate,
    random: np.random.Generator,
    *,
    largest: float = 4.0,
    tries: int = 16,
    iterations: int = 400,
    accept: Callable[[Candidate], bool] = solved,
) -> Candidate | None:
    """Drop a stage of a commutator-free method, and solve again.

    The weights on the stage are added to those on a neighbour, or dropped. The point of the stage
    stays if flows start from it.

    Parameters
    ----------
    candidate, random, largest, tries, iterations, accept
        As for `drop_flow`.

    Returns
    -------
    Candidate or None
        A candidate with one stage less, on the solution set; None if all tries failed.

    Raises
    ------
    ValueError, TypeError
        As for `drop_flow`.
    """
    layout = _check_points(candidate)
    starts = [
        start
        for stage in range(1, layout.stages)
        for receiver in (None, stage - 1, stage + 1)
        if receiver is None or receiver < layout.stages
        for start in _without_stage(candidate, stage, receiver)
    ]
    return first_solved(starts, random, largest, tries, iterations, accept, _PROMISING)


def _check_points(candidate: Candidate) -> Layout:
    layout = check_candidate(candidate).system.layout
    if layout.rows is not None:
        raise ValueError("candidate must be a method of points, got a tableau")
    return layout


def _without_stage(candidate: Candidate, stage: int, receiver: int | None) -> Iterator[Candidate]:
    layout = candidate.system.layout
    weights = layout.point_weights(candidate.x.tolist())
    for row in weights:
        weight = row.pop(stage, None)
        if weight is not None and receiver in row:
            row[receiver] += weight
    renumbered = [{k - (k > stage): w for k, w in row.items()} for row in weights]
    stage_points = layout.stage_points[:stage] + layout.stage_points[stage + 1 :]
    ends = (*stage_points, *layout.results)
    kept = sorted({m for end in ends for m in layout.path(end)})
    if all(renumbered[m] for m in kept):
        smaller, x = select_points(layout, layout.parents, renumbered, stage_points, kept)
        if smaller.uses_every_stage:
            yield Candidate(replace(candidate.system, layout=smaller), x)
