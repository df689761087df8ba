"""Distinct solutions of the runs in a store."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from cg.construction.candidate import Candidate
from cg.construction.layouts.layout import Layout, Rows
from cg.construction.runs import StoredRun, StoredStart
from cg.construction.search.shapes import layout_from_json
from cg.construction.solvers.singular import decompose, retract
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.support import quads
from cg.support.checks import check_integer
from cg.support.parallel import single_threads

_SAME = 1e-8  # largest distance of equal coefficients
_MAX_STEPS = 200  # of a walk from one solution to another
_NEIGHBOURS = 5  # number of nearest solutions to which walks are tried
_MAX_STEP, _MIN_STEP = 0.3, 1e-3
_MIN_GAIN = 1e-3  # of a step, relative to the remaining distance

_ROUNDING = 1e-8  # largest residual of a condition at a solution
OBJECTIVES = ("principal_error", "largest_coefficient", "flows", "residual", "seconds")


@dataclass(frozen=True)
class StoredSolution:
    """A solved start of a store: its entry, its coefficients in double and their conditions."""

    start: StoredStart
    candidate: Candidate

    @cached_property
    def principal_error(self) -> float:
        """Norm of the residuals of the next order."""
        return self.candidate.principal_error

    def objective(self, name: str) -> float:
        """Return the value of one of `OBJECTIVES`, small for a good solution."""
        match name:
            case "principal_error":
                return self.principal_error
            case "largest_coefficient":
                return self.candidate.largest
            case "flows":
                layout = self.candidate.system.layout
                return float(layout.size if layout.rows is not None else len(layout.parents))
            case "residual":
                residual = self.start.largest_residual
                return self.start.f if residual is None else residual
            case "seconds":
                return self.start.seconds
        raise ValueError(f"objective must be one of {', '.join(OBJECTIVES)}, got {name!r}")


def solutions(run: StoredRun) -> Iterator[StoredSolution]:
    """Yield the distinct solutions of a run, by number of the start."""
    settings = run.settings()
    seen: set[tuple[Layout, tuple[float, ...]]] = set()
    for entry in run.entries("AND solved ORDER BY number"):
        candidate = _candidate(settings, entry)
        _check(run, entry, candidate)
        key = candidate.system.layout, tuple(np.round(candidate.x, 8).tolist())
        if key not in seen:
            seen.add(key)
            yield StoredSolution(entry, candidate)


def best(
    run: StoredRun, objective: str = "principal_error", count: int = 10
) -> list[StoredSolution]:
    """Return the best distinct solutions of a run by one of `OBJECTIVES`, the best one first."""
    if objective not in OBJECTIVES:
        raise ValueError(f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}")
    count = check_integer("count", count, 1)
    return heapq.nsmallest(
        count, solutions(run), key=lambda solution: solution.objective(objective)
    )


@single_threads()
def families(distinct: list[StoredSolution]) -> list[list[StoredSolution]]:
    """Group solutions that a walk along the solution set connects, the largest family first.

    Each walk leads to one of the nearest solutions. One that fails proves nothing, so that the
    number of families is an upper bound of the number of components of the set.
    """
    groups = DisjointSet(range(len(distinct)))
    for place, solution in enumerate(distinct):
        for k in _nearest(distinct, place):
            joined = groups.connected(k, place)
            if not joined and connected(solution.candidate, distinct[k].candidate):
                groups.merge(k, place)
    members = sorted(sorted(subset) for subset in groups.subsets())
    grouped = ([distinct[k] for k in group] for group in members)
    return sorted(grouped, key=len, reverse=True)


def _nearest(distinct: list[StoredSolution], place: int) -> list[int]:
    """Return the indices of the nearest solutions of the same shape."""
    here = distinct[place].candidate
    distances = [
        (float(np.linalg.norm(other.candidate.x - here.x)), k)
        for k, other in enumerate(distinct)
        if k != place and other.candidate.system == here.system
    ]
    return [k for _, k in heapq.nsmallest(_NEIGHBOURS, distances)]


def connected(here: Candidate, there: Candidate) -> bool:
    """Return whether a walk along the solution set leads from one solution to another."""
    system = here.system
    if system != there.system or here.rank != there.rank:
        return False
    x, left, longest = here.x, float(np.linalg.norm(there.x - here.x)), _MAX_STEP
    for _ in range(_MAX_STEPS):
        if left <= _SAME * max(1.0, there.largest):
            return True
        near = decompose(system.jacobian(x)[:, system.movable])
        along = near.kernel @ (near.kernel.T @ (there.x - x)[system.movable])
        step = float(np.linalg.norm(along))
        if step < _MIN_GAIN * left or longest < _MIN_STEP:
            return False
        trial = x.copy()
        trial[system.movable] += along * min(1.0, longest / step)
        corrected = retract(system, trial, system.movable, near)
        if corrected is None:  # too far from the set
            longest *= 0.5
            continue
        distance = float(np.linalg.norm(there.x - corrected))
        if distance > left * (1.0 - 1e-6):
            return False
        x, left, longest = corrected, distance, min(_MAX_STEP, 2.0 * longest)
    return False


def _check(run: StoredRun, entry: StoredStart, candidate: Candidate) -> None:
    """Raise ValueError if a candidate that is recorded as a solution isn't one."""
    x = candidate.x
    with np.errstate(invalid="ignore", over="ignore"):
        largest = np.abs(candidate.system.residual(x, independent=False)).max(initial=0.0)
    # residuals of solutions are rounding errors, which grow with the coefficients
    if not largest <= _ROUNDING * max(1.0, candidate.largest) ** 2:
        raise ValueError(
            f"start {entry.number} of run {run.number} in {run.path} is recorded as a solution, "
            f"but a residual is {largest:.3g}"
        )


def _candidate(settings: dict[str, Any], entry: StoredStart) -> Candidate:
    tree = settings.get("tree") if entry.tree is None else entry.tree
    if tree is None:
        layout = Layout.tableau(entry.stages, Rows(settings.get("rows", 0)))
    else:
        layout = layout_from_json(tree)
    structure = Structure(settings.get("structure", 0))
    hold = tuple(map(tuple, settings.get("hold", ())))
    system = ConditionSystem(settings["order"], layout, structure, hold)
    x = quads.to_float(entry.quads)
    if x.size != system.size:
        raise ValueError(f"not the entry of a start: {x.size} coefficients at {entry.number}")
    return Candidate(system, x)
