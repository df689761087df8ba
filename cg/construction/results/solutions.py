"""Solutions in a store, told apart."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...runs import Record, StoredRun
from ...structure.layout import Layout, Rows
from ...support import quads
from ...support.checks import check_integer
from ...support.parallel import single_threads
from ..candidate import Candidate
from ..optimise import principal_error
from ..solvers.singular import decompose, retract
from ..solvers.system import ConditionSystem, Structure

__all__ = ["OBJECTIVES", "Solution", "best", "families", "solutions"]

_SAME = 1e-8  # coefficients this close are the same
_STEPS = 200  # along the solution set from one solution to another
_NEIGHBOURS = 5  # that a walk leads to from each solution
_LONGEST, _SHORTEST = 0.3, 1e-3  # of steps
_MIN_GAIN = 1e-3  # of a step, relative to the distance that is left

_ROUNDING = 1e-8  # in conditions at solutions
OBJECTIVES = ("principal-error", "largest-coefficient", "flows", "residual", "seconds")


@dataclass(frozen=True)
class Solution:
    """A start of a store that led to what was wanted.

    Attributes
    ----------
    record : Record
    candidate : Candidate
        Its coefficients in double, with the conditions that they solve.
    """

    record: Record
    candidate: Candidate

    @cached_property
    def principal_error(self) -> float:
        """Norm of the residuals of the next order."""
        return principal_error(self.candidate)

    def objective(self, name: str) -> float:
        """Return what is small for a good solution, by its name in `OBJECTIVES`.

        Raises
        ------
        ValueError
            If there is no such name.
        """
        match name:
            case "principal-error":
                return self.principal_error
            case "largest-coefficient":
                return self.candidate.largest
            case "flows":
                layout = self.candidate.system.layout
                return float(layout.size if layout.rows is not None else len(layout.parents))
            case "residual":
                residual = self.record.largest_residual
                return self.record.f if residual is None else residual
            case "seconds":
                return self.record.seconds
        raise ValueError(f"objective must be one of {', '.join(OBJECTIVES)}, got {name!r}")


def solutions(run: StoredRun) -> Iterator[Solution]:
    """Yield the starts of a run that led to what was wanted, distinct ones, by number.

    Raises
    ------
    ValueError
        If a start isn't what its record says.

    Examples
    --------
    >>> import tempfile, cg
    >>> from cg.runs import Store
    >>> path = tempfile.mkdtemp() + "/runs.db"
    >>> _ = cg.search(order=2, stages=2, starts=3, seed=1, store=path)
    >>> with Store(path) as store:
    ...     [one.record.number for one in solutions(store.run(1))]
    [0, 1, 2]
    """
    settings = run.settings()
    seen: set[tuple[Layout, tuple[float, ...]]] = set()
    for record in run.records("AND solved ORDER BY number"):
        candidate = _candidate(settings, record)
        _check(run, record, candidate)
        key = candidate.system.layout, tuple(np.round(candidate.x, 8).tolist())
        if key not in seen:
            seen.add(key)
            yield Solution(record, candidate)


def best(run: StoredRun, objective: str = "principal-error", count: int = 10) -> list[Solution]:
    """Return the best distinct solutions of a run, the best one first.

    Parameters
    ----------
    run : StoredRun
    objective : {"principal-error", "largest-coefficient", "flows", "residual", "seconds"}, optional
    count : int, optional
        How many at most.

    Raises
    ------
    ValueError
        If there is no such objective, or `count` isn't positive.
    """
    if objective not in OBJECTIVES:
        raise ValueError(f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}")
    count = check_integer("count", count, 1)
    return heapq.nsmallest(count, solutions(run), key=lambda one: one.objective(objective))


@single_threads()
def families(found: list[Solution]) -> list[list[Solution]]:
    """Group solutions that a walk along the solution set connects.

    From each solution steps lead towards its nearest neighbours, each within the tangent space of
    the set and back to the set. If they arrive, both are of one component of the set. If they
    don't, nothing is proved: there may be a way around, so that there are at most so many
    families.

    Returns
    -------
    list of list of Solution
        Largest family first.
    """
    groups = list(range(len(found)))

    def root(place: int) -> int:
        while groups[place] != place:
            place = groups[place]
        return place

    for place, one in enumerate(found):
        for other in _nearest(found, place):
            if root(other) != root(place) and connected(one.candidate, found[other].candidate):
                groups[root(other)] = root(place)
    grouped: dict[int, list[Solution]] = {}
    for place, one in enumerate(found):
        grouped.setdefault(root(place), []).append(one)
    return sorted(grouped.values(), key=len, reverse=True)


def _nearest(found: list[Solution], place: int) -> list[int]:
    """Return the places of the nearest solutions of the same shape."""
    here = found[place].candidate
    distances = [
        (float(np.linalg.norm(other.candidate.x - here.x)), k)
        for k, other in enumerate(found)
        if k != place and other.candidate.system == here.system
    ]
    return [k for _, k in heapq.nsmallest(_NEIGHBOURS, distances)]


def connected(here: Candidate, there: Candidate) -> bool:
    """Tell whether a walk along the solution set leads from one solution to another."""
    system = here.system
    if system != there.system or here.rank != there.rank:
        return False
    x, left, longest = here.x, float(np.linalg.norm(there.x - here.x)), _LONGEST
    for _ in range(_STEPS):
        if left <= _SAME * max(1.0, there.largest):
            return True
        near = decompose(system.jacobian(x)[:, system.free])
        along = near.kernel @ (near.kernel.T @ (there.x - x)[system.free])
        step = float(np.linalg.norm(along))
        if step < _MIN_GAIN * left or longest < _SHORTEST:
            return False
        trial = x.copy()
        trial[system.free] += along * min(1.0, longest / step)
        arrived = retract(system, trial, system.free, near)
        if arrived is None:  # too far from the set
            longest *= 0.5
            continue
        distance = float(np.linalg.norm(there.x - arrived))
        if distance > left * (1.0 - 1e-6):
            return False
        x, left, longest = arrived, distance, min(_LONGEST, 2.0 * longest)
    return False


def _check(run: StoredRun, record: Record, candidate: Candidate) -> None:
    """Raise ValueError if what is recorded as a solution is none: somebody else wrote it."""
    x = candidate.x
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(candidate.system.residual(x, independent=False)).max(initial=0.0)
    # of solutions rounding is left, larger where coefficients are
    if not off <= _ROUNDING * max(1.0, candidate.largest) ** 2:
        raise ValueError(
            f"start {record.number} of run {run.number} in {run.path} is recorded as a solution, "
            f"but a condition is off by {off:.3g}"
        )


def _candidate(settings: dict[str, Any], record: Record) -> Candidate:
    structure = Structure(settings.get("structure", 0))
    system = ConditionSystem(settings["order"], _layout(settings, record), structure)
    bits = np.frombuffer(record.coefficients, np.int8).reshape(-1, 16)
    x = quads.to_float(bits)
    if x.size != system.size:
        raise ValueError(f"not the record of a start: {x.size} coefficients at {record.number}")
    return Candidate(system, x)


def _layout(settings: dict[str, Any], record: Record) -> Layout:
    tree = settings.get("tree") if record.tree is None else json.loads(record.tree)
    if tree is None:
        return Layout.tableau(record.stages, Rows(settings.get("rows", 0)))
    return Layout(
        tuple(tree["parents"]),
        tuple(map(tuple, tree["weights"])),
        tuple(tree["stage_points"]),
        tuple(tree["results"]),
    )
