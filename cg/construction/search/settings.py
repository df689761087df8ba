"""Settings of searches and constructions: defaults, and the check of the arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cg.construction.conditions import Rows, check_rows
from cg.construction.conditions.counts import check_order
from cg.construction.layouts import MAX_STAGES, Layout
from cg.construction.points import START
from cg.construction.search.shapes import draw_layout, layout_of, max_unknowns
from cg.construction.solvers.held import Hold, read_hold, register_chain
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.construction.trees import rooted_trees_through
from cg.support.checks import MAX_COUNT, check_choice, check_flag, check_integer, check_real

MAX_HALF_WIDTH = 1e300
"""Largest half-width of initial guesses; twice this must not overflow."""

MIN_STAGES = (1, 2, 3, 4, 6, 7, 9, 11)
"""Smallest numbers of stages of explicit methods of orders 1, 2, ... where flows commute [1]_.

References
----------
.. [1] J. C. Butcher, Numerical Methods for Ordinary Differential Equations, 3rd ed., 2016,
   Section 324.
"""

ALGORITHMS = ("minimum-norm", "lmdif")

# Half-widths of guesses and largest numbers of evaluations with which the minimum-norm solver found
# most methods per second: of tableaux through order four, of order five and above, and of trees.
_TABLEAUX = {4: (1.0, 120), 5: (0.75, 500), 6: (0.3, 1000)}
_TREES, _REGISTERS = (0.4, 600), (0.7, 600)


class StartSettings(NamedTuple):
    """Default settings of the random starts of constructions."""

    stages: int  # at first, before some are eliminated; unused for trees
    width: float  # guesses are uniform in [-width, width]
    iterations: int
    promising: float  # sum of squares below which the solver runs a second time


# By structure and order; higher orders take the settings of the highest one. As many unknowns as
# equations would take up to three stages fewer, twelve with GENERAL in order 6, but starts rarely
# reach the solution set then. Untested are orders 5 and 7 with STAGE_ORDER_TWO, and 7 with GENERAL.
_STARTS = {
    Structure.GENERAL: {
        1: StartSettings(1, 1.0, 500, 1e-15),
        2: StartSettings(2, 1.0, 500, 1e-15),
        3: StartSettings(3, 1.0, 500, 1e-15),
        4: StartSettings(5, 1.0, 500, 1e-15),
        5: StartSettings(10, 0.5, 500, 1e-15),
        6: StartSettings(27, 0.5, 500, 1e-15),
        7: StartSettings(51, 0.3, 1000, 1e-15),
    },
    Structure.STAGE_ORDER_TWO: {
        4: StartSettings(6, 1.0, 200, 1e-12),
        5: StartSettings(10, 0.5, 300, 1e-13),
        6: StartSettings(16, 0.3, 300, 1e-13),
        7: StartSettings(40, 0.3, 300, 1e-13),
    },
    Structure.MIDDLE: {
        4: StartSettings(6, 1.0, 100, 1e-10),
        5: StartSettings(10, 0.6, 100, 1e-10),
        6: StartSettings(15, 0.5, 150, 1e-12),
        7: StartSettings(36, 0.3, 250, 1e-14),
    },
}

_FOR_TABLEAUX = ("rows", "structure", "first_stages")
_EXCLUDED = {
    "registers": ("tree", "flows", "first_same_as_last", "hold", *_FOR_TABLEAUX),
    "a tree": ("first_same_as_last", *_FOR_TABLEAUX),
    "flows": ("hold", *_FOR_TABLEAUX),  # coefficients of trees that are drawn have no names
    "a tableau": ("first_same_as_last",),
}
"""By the shape of methods: arguments that don't apply to it."""

_COUNT = partial(check_integer, lower=1, upper=MAX_COUNT)
_CHECKS: dict[str, Callable[[str, Any], float]] = {
    "width": partial(check_real, positive=True, upper=MAX_HALF_WIDTH),
    "maxfev": _COUNT,
    "refine_below": check_real,
    "refine_maxfev": _COUNT,
    "iterations": _COUNT,
    "max_coefficient": partial(check_real, positive=True),
    "restarts": partial(check_integer, lower=0),
}


def likely_structure(order: int, stages: int, embedded: bool) -> Structure:
    """Return GENERAL up to order five if it has enough unknowns, else MIDDLE if that has enough."""
    general = ConditionSystem.tableau(order, stages, embedded=embedded)
    if (order >= 4 and stages >= 3) and (order >= 6 or general.movable.size < general.equations):
        middle = ConditionSystem.tableau(
            order, stages, embedded=embedded, structure=Structure.MIDDLE
        )
        if middle.movable.size >= middle.equations:
            return Structure.MIDDLE
    return Structure.GENERAL


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The arguments of `cg.search` or `cg.construct` that determine the result."""

    kind: str  # "search" or "construct"
    order: int
    stages: int
    seed: int
    width: float
    flows: int | None = None  # None for tableaux
    embedded: bool = False
    tree: Layout | None = None  # None for tableaux and trees drawn at random
    first_same_as_last: bool = False
    hold: Hold = ()
    # The next ones are for searches.
    registers: bool = False
    algorithm: str = ALGORITHMS[0]
    rows: Rows = Rows.EXPLICIT
    maxfev: int = 0
    refine_below: float = 0.0
    refine_maxfev: int = 0
    # The rest is for constructions, which eliminate stages or flows.
    structure: Structure = Structure.GENERAL
    first_stages: int = 0
    first_flows: int | None = None
    iterations: int = 0
    promising: float = 0.0
    max_coefficient: float = 0.0
    restarts: int = 0

    @classmethod
    def checked(
        cls, kind: str, force: bool, order: int, stages: int, seed: int, *,
        hold: Mapping[str, Any] | None, **others: Any,
    ) -> Settings:  # fmt: skip
        """Return the settings of the arguments of a function, checked, with defaults for None."""
        force = check_flag("force", force)
        settings = cls(
            kind=kind,
            order=check_order(order),
            stages=check_integer("stages", stages, 1, MAX_STAGES),
            seed=check_integer("seed", seed, 0),
            hold=() if hold is None else read_hold(hold),
            **others,
        )
        check_choice("algorithm", settings.algorithm, ALGORITHMS)
        flags = ("registers", "embedded", "first_same_as_last")
        changes: dict[str, Any] = {
            name: check_flag(name, getattr(settings, name)) for name in flags
        }
        settings = replace(settings, rows=check_rows(settings.rows), **changes)._with_shape()
        settings._check_counts(force)
        return settings._for_search() if kind == "search" else settings._for_construction()

    def system(self, layout: Layout) -> ConditionSystem:
        """Return the conditions on methods of a layout."""
        return ConditionSystem(self.order, layout, self.structure, self.hold, self.registers)

    @property
    def layout(self) -> Layout | None:
        """The layout of all methods; None if trees are drawn."""
        if self.of_points:
            return self.tree
        return Layout.tableau(self.stages, self.rows, self.embedded)

    @property
    def of_points(self) -> bool:
        """Whether the settings describe methods of points, not tableaux."""
        given = self.tree, self.flows, self.first_flows
        return self.registers or given != (None, None, None)

    def tree_for(self, flows: int, random: np.random.Generator) -> Layout:
        """Return the given tree, or one that is drawn at random."""
        options = {"embedded": self.embedded, "first_same_as_last": self.first_same_as_last}
        return self.tree or draw_layout(self.stages, flows, random, **options)

    def _with_shape(self) -> Settings:
        """Return the settings with a structure of tableaux, or a tree and numbers of flows."""
        shape = "flows" if self.of_points else "a tableau"
        shape = "registers" if self.registers else "a tree" if self.tree is not None else shape
        unused = "flows" if self.kind == "search" else "first_flows"
        for name in (*_EXCLUDED[shape], *[unused][: shape == "a tree"]):
            if value := getattr(self, name):
                got = dict(value) if name == "hold" else value
                raise ValueError(f"{name} must not be given with {shape}, got {got!r}")
        if shape == "a tableau":
            return self._with_structure()
        check_integer("stages", self.stages, 1 + (self.registers and self.embedded))
        settings = replace(self, structure=Structure.GENERAL)
        if shape == "registers":
            return replace(settings, tree=register_chain(self.stages, self.order, self.embedded))
        return settings._with_tree() if shape == "a tree" else settings._with_flows()

    def _with_structure(self) -> Settings:
        order, stages, structure = self.order, self.stages, self.structure
        if structure is None:
            likely = likely_structure(order, stages, self.embedded)
            structure = Structure.GENERAL if self.hold else likely
        system = ConditionSystem.tableau(order, stages, self.rows, self.embedded, structure)
        return replace(self, structure=system.structure)

    def _with_flows(self) -> Settings:
        lower, upper = self.stages - self.first_same_as_last, 10 * MAX_STAGES
        check_integer("stages", self.stages, 1 + self.first_same_as_last)
        flows = check_integer("flows", self.flows, lower, upper)
        if self.kind == "search":
            return replace(self, flows=flows)
        first_flows = flows if self.first_flows is None else self.first_flows
        first_flows = check_integer("first_flows", first_flows, flows, upper)
        return replace(self, flows=flows, first_flows=first_flows)

    def _with_tree(self) -> Settings:
        layout = layout_of(self.tree)
        if layout.stages != self.stages:
            given = f"{layout.stages}, got {self.stages}"
            raise ValueError(f"stages must be those of the tree, {given}")
        if self.embedded and not layout.pair:
            raise ValueError("embedded must be False, as tree has no second result")
        if self.kind == "search":
            return replace(self, tree=layout)
        upper = layout.flows
        lower = len({START, *layout.stage_points, layout.results[0]}) - 1
        flows = upper if self.flows is None else check_integer("flows", self.flows, lower, upper)
        return replace(self, tree=layout, flows=flows, first_flows=upper, embedded=layout.pair)

    def _check_counts(self, force: bool) -> None:
        """Refuse methods with too few stages or unknowns, unless `force` is true.

        Conditions on methods of points are counted where flows commute.
        """
        order, layout, stages = self.order, self.layout, self.stages - self.first_same_as_last
        conditions, kind = len(rooted_trees_through(order)), "conditions where flows commute"
        if layout is None:
            size = max_unknowns(stages, self.flows or 0)
        else:
            system = self.system(layout)
            size = system.movable.size
        if self.registers:
            conditions += len(rooted_trees_through(order - 1)) if self.embedded else 0
        elif not self.of_points:
            conditions, kind = system.equations, "independent conditions"
        elif stages < (needed := MIN_STAGES[order - 1]):
            few = f"stages = {stages} is too few for order {order}, which needs {needed}"
            refuse(force, f"{few} even where flows commute")
        if size < conditions:
            subject = f"stages = {stages} gives" + " two registers" * self.registers
            few = f"{'hold leaves' if self.hold else subject} {size} unknowns for {conditions}"
            structure = f" with structure {self.structure.name}" * bool(self.structure)
            refuse(force, f"{few} {kind} of order {order}{structure}")

    def _for_search(self) -> Settings:
        """Return the settings of a search with defaults for None."""
        layout, lmdif = self.layout, self.algorithm == "lmdif"
        if lmdif and (self.hold or self.registers or self.embedded or (layout and layout.pair)):
            raise ValueError(
                "algorithm must be 'minimum-norm' with hold, registers or pairs, got 'lmdif'"
            )
        size = max_unknowns(self.stages, self.flows or 0)
        if layout is not None:
            size = layout.size - len(layout.fixed)
        width, maxfev = _TREES if self.of_points else _TABLEAUX[min(max(self.order, 4), 6)]
        if self.registers:
            width, maxfev = _REGISTERS
        elif lmdif:
            width, maxfev = 1.0, 200 * (size + 1)
        return self._with_numbers(
            width=width, maxfev=maxfev, refine_below=None, refine_maxfev=20 * (size + 1)
        )

    def _for_construction(self) -> Settings:
        """Return the settings of a construction with defaults for None."""
        order, stages, first_stages = self.order, self.stages, self.first_stages
        starts = _STARTS[self.structure]
        start = starts[min(order, max(starts))]
        if self.of_points:
            start = StartSettings(1, _TREES[0], 300 if order < 7 else 1500, 1e-14)
        if first_stages is None:
            first_stages = stages if self.hold else max(stages, start.stages)
        first_stages = check_integer("first_stages", first_stages, stages, MAX_STAGES)
        if self.hold and (first_stages, self.first_flows) != (stages, self.flows):
            raise ValueError("hold must be None if stages or flows are eliminated")
        settings = replace(self, first_stages=first_stages, promising=start.promising)
        return settings._with_numbers(
            width=start.width, iterations=start.iterations, max_coefficient=None, restarts=None
        )

    def _with_numbers(self, **defaults: Any) -> Settings:
        """Return the settings with defaults in place of None, after checking the numbers."""
        numbers: dict[str, Any] = {}
        for name, default in defaults.items():
            given = getattr(self, name)
            numbers[name] = _CHECKS[name](name, default if given is None else given)
        return replace(self, **numbers)


def refuse(force: bool, problem: str) -> None:
    """Raise ValueError for arguments that allow no method, unless `force` is true."""
    if not force:
        raise ValueError(f"{problem}; pass force=True to try nevertheless")
