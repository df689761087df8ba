"""One attempt of a construction: a random start, then fewer stages or flows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.candidate import (
    Candidate,
    NotExactError,
    default_name,
    refinable,
    solved,
    to_method,
)
from cg.construction.drop import drop_flow, fixed_entries, solve_start
from cg.construction.eliminate import eliminate, walk
from cg.construction.layouts.layout import Layout
from cg.construction.methods.method import Method
from cg.construction.search.requirements import Requirements
from cg.construction.search.settings import Settings
from cg.construction.search.shapes import draw_guess, layout_of_fields, start_generator
from cg.construction.solvers.system import ConditionSystem, Structure

_FIXED = (0.3, 0.8)  # range of entries that are held fixed


@dataclass(frozen=True)
class Attempt:
    """The result of one try, which its number `index` and the settings determine."""

    index: int
    stages: int  # the fewest reached
    solved: bool  # whether x is on the solution set and within bounds
    f: float  # sum of squared residuals in double
    x: tuple[float, ...] = field(repr=False)
    flows: int | None = None  # None for tableaux, as is tree
    tree: Layout | None = field(default=None, repr=False)

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any]) -> Attempt:
        """Return the try that `dataclasses.asdict` made fields of."""
        tree = fields["tree"] and layout_of_fields(fields["tree"])
        return cls(**{**fields, "x": tuple(fields["x"]), "tree": tree})


def run_attempt(settings: Settings, index: int) -> Attempt:
    """Run one try: solve from a random guess, then eliminate stages or flows."""
    random, accept = start_generator(settings.seed, index), partial(acceptable, settings)
    if settings.first_flows is not None:
        layout = settings.tree_for(settings.first_flows, random)
    else:
        spread = max(0, settings.first_stages - settings.stages)
        stages = settings.first_stages + (int(random.integers(0, 4)) if spread else 0)
        layout = Layout.tableau(stages, pair=settings.embedded)
    guess = random_candidate(settings.system(layout), settings.width, random)
    candidate = solve_start(guess, settings.iterations, promising=settings.promising)
    if settings.flows is not None:
        candidate = _with_fewer_flows(settings, candidate, random)
    elif accept(candidate):
        for smaller in eliminate(
            candidate, settings.stages, random=random, largest=settings.largest,
            restarts=settings.restarts, accept=accept,
        ):  # fmt: skip
            candidate = smaller
    layout, x = candidate.system.layout, tuple(candidate.x.tolist())
    points = (_flows(settings, layout), layout) if layout.rows is None else ()
    return Attempt(index, layout.stages, accept(candidate), candidate.f, x, *points)


def random_candidate(
    system: ConditionSystem, width: float, random: np.random.Generator
) -> Candidate:
    """Return a random guess that satisfies the linear equations of the system's structure."""
    if system.rows is None:
        return Candidate(system, draw_guess(system.order, system.layout, width, random))
    x = random.uniform(-width, width, system.size)
    x[np.setdiff1d(np.arange(system.size), system.movable)] = 0.0
    x[fixed_entries(system)] = random.uniform(*_FIXED)
    if system.structure is Structure.MIDDLE:
        _to_the_middle(x, system.layout.row(system.stages), system.stages)
    return Candidate(system, x)


def _to_the_middle(x: NDArray[np.float64], weights: Sequence[int], stages: int) -> None:
    """Shift the weights to sum 1, and the rows to the abscissae of structure MIDDLE."""
    b = x[weights]
    b[2:] += (1 - b.sum()) / (stages - 2)
    x[weights], ends = b, np.cumsum(b)
    for row in range(2, stages):
        entries = slice(row * (row - 1) // 2, row * (row + 1) // 2)
        x[entries] += (ends[row] - b[row] / 2 - x[entries].sum()) / row


def _with_fewer_flows(
    settings: Settings, candidate: Candidate, random: np.random.Generator
) -> Candidate:
    """Return what is left when flows are dropped one by one, with walks where that fails."""
    walks, accept = 0, partial(acceptable, settings)
    while accept(candidate) and walks <= settings.restarts:
        if _flows(settings, candidate.system.layout) == settings.flows:
            break
        smaller = drop_flow(candidate, random, largest=settings.largest, accept=accept)
        if smaller is None:
            walks += 1
            candidate = walk(candidate, random, largest=settings.largest)
        else:
            candidate, walks = smaller, 0
    return candidate


def _flows(settings: Settings, layout: Layout) -> int:
    """Return the number of flows of a layout without that of a second result."""
    return len(layout.parents) - settings.embedded


def succeeded(settings: Settings, attempt: Attempt) -> bool:
    """Return whether a try reached a solution with the stages and flows of the settings."""
    goal = settings.stages, settings.flows
    return attempt.solved and (attempt.stages, attempt.flows) == goal


def acceptable(settings: Settings, candidate: Candidate) -> bool:
    """Return whether a candidate is on the solution set, and as the settings require."""
    if not solved(candidate) or candidate.largest > settings.largest or not refinable(candidate):
        return False
    if candidate.blind:
        return False
    return not settings.full_rank or candidate.rank == candidate.system.equations


def refined(settings: Settings, attempt: Attempt, requirements: Requirements) -> Method | None:
    """Return the method of a try, refined in real(16); None if it isn't exact or as required."""
    x = np.array(attempt.x, dtype=np.float64)
    layout = attempt.tree or Layout.tableau(attempt.stages, pair=settings.embedded)
    candidate = requirements.improve(Candidate(settings.system(layout), x))
    if candidate is None:
        return None
    name = default_name(candidate.system, settings.seed, f"try{attempt.index}")
    source = f"construct, seed {settings.seed}, try {attempt.index}"
    try:
        return to_method(candidate, name=name, source=source)
    except NotExactError:
        return None
