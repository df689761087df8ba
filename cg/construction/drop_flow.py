"""Fewer flows, or fewer stages, of a method of points: leave one out, then solve again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..structure.layout import Layout
from ..structure.points import START
from ..support.checks import check_generator, check_integer, check_real
from .candidate import Candidate, check_candidate, solved
from .drop import solve_start

__all__ = ["drop_flow", "drop_point_stage"]

_PROMISING = 1e-10  # sum of squares from which on the last stretch is tried
_SPREAD = 0.6  # of the order in which ways are tried, in logarithms of f

_Weights = list[dict[int, float]]


def drop_flow(
    candidate: Candidate,
    random: np.random.Generator,
    *,
    largest: float = 4.0,
    tries: int = 16,
    iterations: int = 400,
    accept: Callable[[Candidate], bool] = solved,
) -> Candidate | None:
    """Leave a point out that is neither a stage nor a result, and solve again.

    The flows from it start at its parent instead, with the sums of both flows' weights. What
    is closest to the smaller solution set is tried first, but for some chance.

    Parameters
    ----------
    candidate : Candidate
        On the solution set, of a method of points.
    random : numpy.random.Generator
        Source of the order of tries.
    largest : float, optional
        Bound on the magnitude of weights.
    tries : int, optional
        How many of the possibilities are tried.
    iterations : int, optional
        Bound on the solver's steps in each, and once more where they lead far down.
    accept : callable, optional
        A further test that the smaller candidate has to pass.

    Returns
    -------
    Candidate or None
        With one flow less, on its own solution set; None if all tries failed.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range, or the candidate is a tableau.
    """
    layout = _check_points(candidate)
    inner = [m for m in range(len(layout.parents)) if m not in layout.ends]
    ways = [_merged(candidate, m) for m in inner]
    return _first_solved(ways, random, largest, tries, iterations, accept)


def drop_point_stage(
    candidate: Candidate,
    random: np.random.Generator,
    *,
    largest: float = 4.0,
    tries: int = 16,
    iterations: int = 400,
    accept: Callable[[Candidate], bool] = solved,
) -> Candidate | None:
    """Leave a stage of a method of points out, and solve again.

    Its weights go to a neighbour or are dropped; its point stays if other points start from it.

    Parameters
    ----------
    candidate, random, largest, tries, iterations, accept
        As for `drop_flow`.

    Returns
    -------
    Candidate or None
        With one stage less, on its own solution set; None if all tries failed.

    Raises
    ------
    ValueError, TypeError
        As for `drop_flow`.
    """
    layout = _check_points(candidate)
    ways = [
        way
        for stage in range(1, layout.stages)
        for receiver in (None, stage - 1, stage + 1)
        if receiver is None or receiver < layout.stages
        for way in _without_stage(candidate, stage, receiver)
    ]
    return _first_solved(ways, random, largest, tries, iterations, accept)


def _check_points(candidate: Candidate) -> Layout:
    layout = check_candidate(candidate).system.layout
    if layout.rows is not None:
        raise ValueError("candidate must be a method of points, got a tableau")
    return layout


def _first_solved(
    ways: list[Candidate],
    random: np.random.Generator,
    largest: float,
    tries: int,
    iterations: int,
    accept: Callable[[Candidate], bool],
) -> Candidate | None:
    check_generator("random", random)
    tries = check_integer("tries", tries, 1)
    iterations = check_integer("iterations", iterations, 1)
    largest = check_real("largest", largest, positive=True)
    if not ways:
        return None
    closeness = np.log([max(way.f, 1e-300) for way in ways])
    order = np.argsort(closeness + _SPREAD * random.standard_normal(len(ways)), kind="stable")
    for k in order[:tries]:
        smaller = solve_start(ways[k], iterations, promising=_PROMISING)
        if solved(smaller) and smaller.largest <= largest and accept(smaller):
            return smaller
    return None


def _merged(candidate: Candidate, gone: int) -> Candidate:
    """Leave a point out that is no end; its weights go to the flows that start from it."""
    layout = candidate.system.layout
    weights = _weights(candidate)
    parents = list(layout.parents)
    for m, parent in enumerate(parents):
        if parent == gone:
            parents[m] = parents[gone]
            for stage, weight in weights[gone].items():
                weights[m][stage] = weights[m].get(stage, 0.0) + weight
    kept = [m for m in range(len(parents)) if m != gone]
    return _rebuilt(candidate, parents, weights, layout.stage_points, kept)


def _without_stage(candidate: Candidate, stage: int, receiver: int | None) -> Iterator[Candidate]:
    layout = candidate.system.layout
    weights = _weights(candidate)
    for row in weights:
        weight = row.pop(stage, None)
        if weight is not None and receiver in row:
            row[receiver] += weight
    renumbered = [{k - (k > stage): w for k, w in row.items()} for row in weights]
    stage_points = layout.stage_points[:stage] + layout.stage_points[stage + 1 :]
    ends = (*stage_points, *layout.results)
    kept = sorted({m for end in ends for m in layout.path(end)})
    if all(renumbered[m] for m in kept):
        yield _rebuilt(candidate, list(layout.parents), renumbered, stage_points, kept)


def _weights(candidate: Candidate) -> _Weights:
    return candidate.system.layout.point_weights(candidate.x.tolist())


def _rebuilt(
    candidate: Candidate,
    parents: list[int],
    weights: _Weights,
    stage_points: tuple[int, ...],
    kept: list[int],
) -> Candidate:
    """Return the candidate of the points that are kept, numbered anew."""
    number = {START: START} | {m: k for k, m in enumerate(kept)}
    rows = [dict(sorted(weights[m].items())) for m in kept]
    layout = Layout(
        tuple(number[parents[m]] for m in kept),
        tuple(tuple(row) for row in rows),
        tuple(number[m] for m in stage_points),
        tuple(number[m] for m in candidate.system.layout.results),
    )
    x: NDArray[np.float64] = np.array([weight for row in rows for weight in row.values()])
    return Candidate(replace(candidate.system, layout=layout), x)
