"""Move methods of the literature along the solution set, their tableaux too, as in the catalogue.

`research/make_lifted_methods.py` splits the rows of flat tableaux into flows and holds the
tableaux. Here these move as well: from a lifted method all weights change, down the principal error
and towards small weights.

    python research/make_walked_methods.py FOLDER [NAME ...]
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from make_second_results import RECIPES, flat_estimate
from threadpoolctl import threadpool_limits

import cg
from cg.catalogue import save
from cg.construction import (
    Candidate,
    ConditionSystem,
    Goals,
    correct,
    optimise,
    pack_method,
    to_method,
)

ROUND = 10  # iterations, after which damping starts anew
NOTHING = 1e-9  # weights below are left out at the end


@dataclass(frozen=True)
class Walk:
    """How to find a method.

    Attributes
    ----------
    name : str
    start : str
        A lifted method of the catalogue.
    goals : Goals
        What to minimise.
    rounds : int
    wide : bool
        Whether flows get weights on all stages that they could use.
    """

    name: str
    start: str
    goals: Goals
    rounds: int
    wide: bool = True


WALKS = (
    Walk("CF7(6)", "Verner7(6)", Goals(bound=2.0, bound_weight=1e-4, abscissae=0.05), 20),
    Walk(
        "CF8a",
        "CooperVerner8",
        Goals(bound=3.0, bound_weight=1e-5, abscissae=0.05),
        5,
        wide=False,
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
        {k: weight for k, weight in row.items() if abs(weight) > NOTHING}
        for row in candidate.system.layout.point_weights(candidate.x.tolist())
    ]
    kept = _with(candidate, rows)
    return correct(kept, _held(kept))


def walked(walk: Walk) -> Candidate:
    """Return where a walk leads."""
    start = cg.methods[walk.start]
    assert isinstance(start, cg.CommutatorFree)
    # an estimate that is one frozen combination leaves a walk more room
    candidate = pack_method(flat_estimate(start) if walk.start in RECIPES else start)
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


def main(folder: str, *names: str) -> None:
    """Write the files and say what they hold."""
    known = {walk.name: walk for walk in WALKS}
    if unknown := set(names) - set(known):
        raise SystemExit(f"no walk to {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    Path(folder).mkdir(parents=True, exist_ok=True)
    for name in names or known:
        begun = time.process_time()
        source = (
            f"{known[name].start}, moved along the solution set with its tableau to a small "
            "principal error and small weights"
        )
        found = to_method(walked(known[name]), name=name, source=source)
        save(found, Path(folder) / f"{name}.toml")
        print(
            f"{name}: order {found.order}, {found.exponentials} flows, principal error "
            f"{found.principal_error:.3g}; {time.process_time() - begun:.0f} s of a core",
            flush=True,
        )


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
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    with threadpool_limits(1):
        main(*sys.argv[1:])
