"""Move methods of the literature along the solution set, their tableaux too, as in the catalogue.

`research/make_lifted_methods.py` splits the rows of flat tableaux into flows and holds the
tableaux. Here these move as well: from a lifted method all weights change, down the principal error
and towards small weights.

    python research/make_walked_methods.py FOLDER [NAME ...]
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from recipes import run

import cg
from cg.construction.candidate import Candidate, correct, pack_method, to_method
from cg.construction.methods.method import Method
from cg.construction.optimise import Goals, optimise
from cg.construction.solvers.system import ConditionSystem

ROUND = 10  # iterations, after which damping starts anew
NEGLIGIBLE = 1e-9  # smaller weights are left out at the end


@dataclass(frozen=True)
class Walk:
    """How to find a method."""

    name: str
    start: str  # a lifted method of the catalogue
    goals: Goals
    rounds: int
    wide: bool = True  # whether flows get weights on all stages that they could use


WALKS = (
    Walk("CF7(6)", "Verner7(6)", Goals(bound=2.0, bound_weight=1e-4, abscissae=0.05), 20),
    Walk(
        "CF8a", "CooperVerner8", Goals(bound=3.0, bound_weight=1e-5, abscissae=0.05), 5, wide=False
    ),
)


def widened(candidate: Candidate) -> Candidate:
    """Return the candidate with a weight, zero for now, on each stage that a flow could use."""
    layout = candidate.system.layout
    rows = [
        {k: 0.0 for k, place in enumerate(layout.stage_points) if place < m} | row
        for m, row in enumerate(layout.point_weights(candidate.x.tolist()))
    ]
    return _with(candidate, rows)


def cleaned(candidate: Candidate) -> Candidate:
    """Return the candidate without the weights that are zero but for rounding."""
    rows = [
        {k: weight for k, weight in row.items() if abs(weight) > NEGLIGIBLE}
        for row in candidate.system.layout.point_weights(candidate.x.tolist())
    ]
    cleaned_candidate = _with(candidate, rows)
    return correct(cleaned_candidate, _held(cleaned_candidate))


def walked(walk: Walk) -> Candidate:
    """Return the end of a walk."""
    start = cg.methods[walk.start]
    assert isinstance(start, cg.CommutatorFree)
    # an estimate that is one frozen combination leaves a walk more room
    candidate = pack_method(start if start.embedded is None else flat_estimate(start))
    if walk.wide:
        candidate = widened(candidate)
    held = _held(candidate)
    for number in range(walk.rounds):
        candidate = optimise(
            candidate, walk.goals, frozen=held, max_iterations=ROUND, tolerance=1e-4
        )
        print(
            f"{walk.name}: round {number + 1}, principal error "
            f"{candidate.principal_error:.3e}, largest weight {candidate.largest:.3f}",
            flush=True,
        )
    return cleaned(candidate)


def flat_estimate(pair: cg.CommutatorFree) -> cg.CommutatorFree:
    """Return a pair whose second result is one flow from the first, with the same row b̂."""
    assert pair.exact_embedded is not None
    count = 1 + max(*pair.stage_points, pair.result)
    rows = zip(pair.points[:count], pair.point_coefficients, strict=False)
    points: list[tuple[int, Mapping[int, Any]]] = [(point.parent, row) for point, row in rows]
    weights = zip(pair.exact_embedded, pair.exact[1], strict=True)
    points.append((pair.result, {k: second - b for k, (second, b) in enumerate(weights)}))
    return cg.CommutatorFree(
        points, pair.stage_points, pair.result, embedded_result=count, name=pair.name
    )


def make(name: str) -> Method:
    """Return a method of `WALKS`; `research/make_second_results.py` makes its second result."""
    (walk,) = (walk for walk in WALKS if walk.name == name)
    source = (
        f"{walk.start}, moved along the solution set with its tableau to a small principal error "
        "and small weights"
    )
    return to_method(walked(walk), name=name, source=source)


def _with(candidate: Candidate, rows: list[dict[int, float]]) -> Candidate:
    rows = [dict(sorted(row.items())) for row in rows]
    layout = replace(candidate.system.layout, weights=tuple(map(tuple, rows)))
    x = np.array([weight for row in rows for weight in row.values()])
    return Candidate(ConditionSystem(candidate.system.order, layout), x)


def _held(candidate: Candidate) -> list[int]:
    """Return the largest weight of an estimate, since only their ratios count."""
    layout = candidate.system.layout
    if not layout.pair:
        return []
    first = layout.starts[-2]
    return [first + int(np.argmax(np.abs(candidate.x[first:])))]


if __name__ == "__main__":
    run(make, [walk.name for walk in WALKS], __doc__)
