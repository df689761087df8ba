"""Packed coefficients on the solution set of a system of order conditions, or close to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import core_calls, count
from cg.construction.layouts.layout import Layout, Rows, check_length
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.tableau import Tableau
from cg.construction.search.start import EXACT
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.refine import Refined, polish_zeros, refine
from cg.construction.solvers.system import ConditionSystem, next_trees
from cg.support import quads
from cg.support.checks import check_instance

SOLVED = 1e-23
"""Sum of squared residuals in double below which refinement finds an exact solution nearby."""

_MIN_ESTIMATE = 1e-5  # smallest estimate of pairs


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
    def largest(self) -> float:
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
    def estimate(self) -> float:
        """Norm of the order-q residuals of the second result: the size of the estimate."""
        layout = self.system.layout
        if not layout.pair:
            raise ValueError("candidate must be a pair")
        second = replace(layout, results=layout.results[1:])
        values = ConditionSystem(self.system.order, second).residual(self.x, independent=False)
        return float(np.linalg.norm(values[count(self.system.order - 1) :]))

    @property
    def blind(self) -> bool:
        """Whether it is a pair whose results have one order; equal stages lead to it."""
        return self.system.layout.pair and self.estimate < _MIN_ESTIMATE

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
    return candidate.f / max(1.0, candidate.largest) <= SOLVED * max(1.0, candidate.largest)


def refinable(candidate: Candidate) -> bool:
    """Return whether refinement in real(16) leads to an exact solution."""
    refined, _, bound = _refined(candidate)
    return refined.largest_residual <= bound


def _refined(candidate: Candidate) -> tuple[Refined, NDArray[np.intp], float]:
    """Refine a candidate, whose exact zeros stay; return what may move, and the bound to reach."""
    movable = candidate.system.movable_without(np.flatnonzero(candidate.x == 0))
    refined = refine(quads.from_float(candidate.x), candidate.system, movable=movable)
    return refined, movable, EXACT * max(1.0, candidate.largest)


def pack_method(method: Method, order: int | None = None) -> Candidate:
    """Return a method as a candidate, by default of its order; a pair if it has second weights."""
    check_instance("method", method, Method)
    order = method.order if order is None else order
    system = ConditionSystem(order, method.layout)
    return Candidate(system, np.array([float(entry.value) for entry in method.coefficients]))


def to_method(candidate: Candidate, *, name: str, source: str) -> Method:
    """Refine a candidate in real(16) and return it as a method; NotExactError if that fails.

    Exact zeros stay zero, and entries that are zero up to rounding are set to zero.
    """
    system = candidate.system
    refined, movable, bound = _refined(candidate)
    if refined.largest_residual > bound:
        raise NotExactError(
            f"largest residual {refined.largest_residual:.2e} after refinement, "
            f"more than {bound:.0e}"
        )
    polished = polish_zeros(quads.decode(refined.x), system, movable)
    return make_method(system.layout, system.texts(polished.x), name=name, source=source)


def make_method(
    layout: Layout, coefficients: Sequence[Any], **fields: Any
) -> Tableau | CommutatorFree | MagnusMethod:
    """Return the method with a layout and packed coefficients, which `Coefficient.read` takes."""
    check_length(coefficients, layout.size)
    points = MagnusMethod if layout.of_time else CommutatorFree
    kind = points if layout.rows is None else Tableau
    return kind.from_layout(layout, coefficients, **fields)
