"""Packed coefficients on the solution set of order conditions, or close to it, and steps there.

Stages and flows are eliminated along the solution set. A stage or a flow is dropped, and the
conditions are solved again from the remaining coefficients; or the coefficients of a stage shrink
to zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import core_calls, count
from cg.construction.layouts import Layout, Rows, check_length
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.method import Method
from cg.construction.methods.tableau import Tableau
from cg.construction.search.shapes import fixed_entries, merge_point
from cg.construction.search.start import EXACT
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.refine import Refinement, polish_zeros, refine
from cg.construction.solvers.system import ConditionSystem, Structure, next_trees
from cg.support import quads
from cg.support.checks import check_instance

SOLVED = 1e-23
"""Sum of squared residuals in double below which refinement finds an exact solution nearby; exact
methods of the catalogue have sums below 1e-29."""

# Estimates of pairs of the catalogue are 1e-3 or more; with equal results they are rounding errors.
_MIN_ESTIMATE = 1e-5
_SPREAD = 0.6  # noise of log f: a start with twice the f of another comes first once in five times
_TRIES = 16  # starts to solve from before a walk leads elsewhere


class NotExactError(RuntimeError):
    """Refinement in real(16) did not end at a zero of all order conditions."""


@dataclass(frozen=True)
class Candidate:
    """Packed coefficients x, shape (system.size,), on or close to the solution set of a system."""

    system: ConditionSystem
    x: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", self.system.complete(self.x))

    @property
    def max_coefficient(self) -> float:
        """Magnitude of the largest coefficient."""
        return float(np.abs(self.x).max())

    @property
    def f(self) -> float:
        """Sum of squared residuals of the independent conditions."""
        with np.errstate(over="ignore", invalid="ignore"):  # infinite far from the set
            return float(np.sum(self.system.residual(self.x) ** 2))

    @property
    def next_order(self) -> tuple[int, Layout, NDArray[np.float64], NDArray[np.intc]]:
        """Order q + 1, layout, x, and the trees of order q + 1, as compiled residuals take them."""
        order = self.system.order
        return order + 1, self.system.layout, self.x, next_trees(order)

    @property
    def principal_error(self) -> float:
        """Norm of all residuals of order q + 1 of the (first) weights."""
        return float(np.linalg.norm(core_calls.residuals(*self.next_order)))

    @property
    def estimate_vanishes(self) -> bool:
        """Whether the error estimate of a pair is next to zero: both results have order q.

        Equal stages lead to it. Its size is the norm of the second result's residuals of order q.
        """
        layout, order = self.system.layout, self.system.order
        if not layout.pair:
            return False
        second = ConditionSystem(order, replace(layout, results=layout.results[1:]))
        values = second.residual(self.x, independent=False)[count(order - 1) :]
        return bool(np.linalg.norm(values) < _MIN_ESTIMATE)

    def without(self, stage: int) -> Candidate:
        """Return the candidate without a stage (from 0) whose column is zero."""
        layout, entries = self.system.layout.without(stage)
        return Candidate(replace(self.system, layout=layout), self.x[entries])


def correct(
    candidate: Candidate, frozen: Sequence[int] | NDArray[np.intp] = (), **options: Any
) -> Candidate:
    """Return to the solution set by steps of least norm, with the entries `frozen` held.

    The options are those of `fit_conditions`. Ask `solved` whether the end is on the set.
    """
    system = candidate.system
    defaults = {"ftol": 1e-26, "damping": 1e-6, "max_iterations": 200, "accurate": system.order > 6}
    movable = system.movable_without(frozen)
    fit = fit_conditions(candidate.x, system, movable=movable, **(defaults | options))
    return Candidate(system, fit.x)


def default_name(system: ConditionSystem, seed: int, number: int | str) -> str:
    """Return the name of a method of a search, such as ``CG4-1-17``: order 4, seed 1, start 17."""
    kinds = {Rows.EXPLICIT: "CG", Rows.DIAGONAL: "DICG", Rows.FULL: "ICG", None: "CF"}
    pair = f"({system.order - 1})" if system.layout.pair else ""
    return f"{kinds[system.rows]}{system.order}{pair}-{seed}-{number}"


def solved(candidate: Candidate) -> bool:
    """Return whether the conditions hold up to rounding errors of double precision."""
    # f is divided twice, since the square of large weights may overflow
    size = max(1.0, candidate.max_coefficient)
    return candidate.f / size <= SOLVED * size


def _refined(candidate: Candidate) -> tuple[Refinement, NDArray[np.intp], float]:
    """Refine a candidate, whose exact zeros stay; return what may move, and the bound to reach."""
    movable = candidate.system.movable_without(np.flatnonzero(candidate.x == 0))
    refined = refine(quads.from_float(candidate.x), candidate.system, movable=movable)
    return refined, movable, EXACT * max(1.0, candidate.max_coefficient)


def pack_method(method: Method) -> Candidate:
    """Return a method as a candidate of its order; a pair if it has second weights."""
    check_instance("method", method, Method)
    system = ConditionSystem(method.order, method.layout)
    return Candidate(system, np.array([float(entry.value) for entry in method.coefficients]))


def to_method(candidate: Candidate, *, name: str, source: str) -> Method:
    """Refine a candidate in real(16) and return it as a method; NotExactError if that fails.

    Exact zeros stay zero, and entries that are zero up to rounding are set to zero.
    """
    system = candidate.system
    refined, movable, bound = _refined(candidate)
    if refined.max_residual > bound:
        raise NotExactError(
            f"largest residual {refined.max_residual:.2e} after refinement, more than {bound:.0e}"
        )
    polished = polish_zeros(quads.decode(refined.x), system, movable)
    return make_method(system.layout, system.texts(polished.x), name=name, source=source)


def make_method(
    layout: Layout, coefficients: Sequence[Any], **fields: Any
) -> Tableau | CommutatorFree:
    """Return the method with a layout and packed coefficients, which `Coefficient.read` takes."""
    check_length(coefficients, layout.size)
    kind = CommutatorFree if layout.rows is None else Tableau
    return kind.from_layout(layout, coefficients, **fields)


@dataclass(frozen=True)
class Reduction:
    """Steps along the solution set, by which stages and flows are eliminated."""

    random: np.random.Generator
    max_coefficient: float = 4.0  # bound on coefficients
    restarts: int = 3  # walks after which a number of stages or flows is the smallest

    def accepts(self, candidate: Candidate) -> bool:
        """Return whether a candidate is bounded, on the solution set, and no useless pair."""
        if not (solved(candidate) and candidate.max_coefficient <= self.max_coefficient):
            return False
        refined, _, bound = _refined(candidate)
        return refined.max_residual <= bound and not candidate.estimate_vanishes

    def eliminate(self, candidate: Candidate, size: str, number: int) -> Candidate:
        """Drop ``"stages"`` or ``"flows"`` one by one until `number` are left, or none can be.

        Where dropping fails, `restarts` walks lead to other points of the solution set. Returns the
        smallest candidate.
        """
        smallest, walks = candidate, 0
        while walks <= self.restarts and getattr(candidate.system.layout, size) > number:
            drop = self.drop_stage if size == "stages" else self.drop_flow
            smaller = drop(candidate)
            if smaller is None:
                walks, candidate = walks + 1, self.walk(candidate)
            else:
                walks, candidate, smallest = 0, smaller, smaller
        return smallest

    def walk(self, candidate: Candidate, size: float = 0.3) -> Candidate:
        """Return another point of the solution set, after a random step of length `size`."""
        system, movable = candidate.system, candidate.system.movable
        for _ in range(6):
            x = candidate.x.copy()
            x[movable] += size / np.sqrt(movable.size) * self.random.standard_normal(movable.size)
            moved = correct(Candidate(system, x), fixed_entries(system.order, system.layout))
            if solved(moved) and moved.max_coefficient <= self.max_coefficient:
                return moved
            size /= 2
        return candidate

    def drop_stage(self, candidate: Candidate) -> Candidate | None:
        """Drop a stage of a tableau and solve again; None if no start leads to one.

        The column of the stage is added to that of a neighbour, or dropped.
        """
        starts = list(_without_column(candidate))
        return self._first_solved(starts, iterations=200, promising=1e-14)

    def drop_flow(self, candidate: Candidate) -> Candidate | None:
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
        return self._first_solved(starts, iterations=400, promising=1e-10)

    def _first_solved(
        self, starts: Sequence[Candidate], *, iterations: int, promising: float
    ) -> Candidate | None:
        """Solve from starts until one leads to an acceptable candidate; None if none does."""
        if not starts:
            return None
        closeness = np.log([max(start.f, 1e-300) for start in starts])
        noise = _SPREAD * self.random.standard_normal(len(starts))
        for k in np.argsort(closeness + noise, kind="stable")[:_TRIES]:
            smaller = solve_start(starts[k], iterations, promising=promising)
            if self.accepts(smaller):
                return smaller
        return None


def solve_start(candidate: Candidate, iterations: int, *, promising: float) -> Candidate:
    """Solve from a start, and again if f is at most `promising` after the first run."""
    frozen = fixed_entries(candidate.system.order, candidate.system.layout)
    options: dict[str, Any] = {"ftol": 1e-27, "max_iterations": iterations}
    first = correct(candidate, frozen, damping=1e-2, accurate=False, **options)
    if not 1e-26 < first.f <= promising:  # on the set, but for roundings, or far from it
        return first
    return correct(first, frozen, damping=1e-14, accurate=True, **options)


def _without_column(candidate: Candidate) -> Iterator[Candidate]:
    """Yield the starts without each stage, its column dropped or added to a neighbour."""
    system = candidate.system
    # a structure treats the first two differently
    stages = range(0 if system.structure is Structure.GENERAL else 2, system.stages)
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
