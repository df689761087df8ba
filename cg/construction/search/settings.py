"""Settings of searches and constructions: defaults, and the check of the arguments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cg.construction.conditions import Rows, check_rows
from cg.construction.conditions.counts import check_order
from cg.construction.layouts import START, Layout
from cg.construction.search.shapes import draw_layout, layout_of, most_unknowns, start_generator
from cg.construction.solvers.held import Hold, read_hold, register_chain
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.construction.trees import forest, rooted_trees_through
from cg.support.checks import (
    MAX_COUNT,
    MAX_HALF_WIDTH,
    MAX_STAGES,
    check_choice,
    check_flag,
    check_integer,
    check_real,
)

MIN_STAGES = (1, 2, 3, 4, 6, 7, 9, 11)
"""Smallest numbers of stages of explicit methods of orders 1, 2, ... where flows commute [1]_.

References
----------
.. [1] J. C. Butcher, Numerical Methods for Ordinary Differential Equations, 3rd ed., 2016,
   Section 324.
"""

_RESIDUAL_ROUNDING = 1e-12

ALGORITHMS = ("minimum-norm", "lmdif")

# Half-widths of guesses and largest numbers of evaluations with which the minimum-norm solver found
# most methods per second: of tableaux through order four, of order five and above, and of trees.
_WIDTHS, _TREE_WIDTH, _REGISTER_WIDTH = (1.0, 0.75, 0.3), 0.4, 0.7
_EVALUATIONS, _TREE_EVALUATIONS = (120, 500, 1000), 600


@dataclass(frozen=True)
class StartSettings:
    """Default settings of random starts."""

    stages: int  # with which random starts reach the solution set often enough; unused for trees
    width: float  # guesses are uniform in [-width, width]
    iterations: int
    promising: float  # sum of squares below which the solver runs a second time


_GENERAL = {
    1: StartSettings(1, 1.0, 500, 1e-15),
    2: StartSettings(2, 1.0, 500, 1e-15),
    3: StartSettings(3, 1.0, 500, 1e-15),
    4: StartSettings(5, 1.0, 500, 1e-15),
    5: StartSettings(10, 0.5, 500, 1e-15),
    6: StartSettings(27, 0.5, 500, 1e-15),
    7: StartSettings(51, 0.3, 1000, 1e-15),
}
_STAGE_ORDER_TWO = {
    4: StartSettings(6, 1.0, 200, 1e-12),
    5: StartSettings(10, 0.5, 300, 1e-13),
    6: StartSettings(16, 0.3, 300, 1e-13),
    7: StartSettings(40, 0.3, 300, 1e-13),
}
_MIDDLE = {
    4: StartSettings(6, 1.0, 100, 1e-10),
    5: StartSettings(10, 0.6, 100, 1e-10),
    6: StartSettings(15, 0.5, 150, 1e-12),
    7: StartSettings(36, 0.3, 250, 1e-14),
}


def default_start(order: int, structure: Structure, embedded: bool = False) -> StartSettings:
    """Return the default settings for tableaux.

    Above order seven they are those of order seven, with as many stages as there are equations for.
    Untested are orders 5 and 7 with STAGE_ORDER_TWO, and order 7 with GENERAL.
    """
    known = (_GENERAL, _STAGE_ORDER_TWO, _MIDDLE)[structure]
    if order in known:
        return known[order]
    last = known[max(known)]
    stages = last.stages
    while True:
        system = ConditionSystem.tableau(order, stages, embedded=embedded, structure=structure)
        if system.movable.size > system.equations:
            return replace(last, stages=stages)
        stages += 1


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
    # for searches
    registers: bool = False
    algorithm: str = ALGORITHMS[0]
    rows: Rows = Rows.EXPLICIT
    maxfev: int = 0
    refine_below: float = 0.0
    refine_maxfev: int = 0
    # for constructions, which eliminate stages or flows
    structure: Structure = Structure.GENERAL
    first_stages: int = 0
    first_flows: int | None = None
    iterations: int = 0
    promising: float = 0.0
    largest: float = 0.0
    restarts: int = 0

    @classmethod
    def checked(
        cls,
        kind: str,
        force: bool,
        order: int,
        stages: int,
        seed: int,
        *,
        hold: Mapping[str, Any] | None,
        **others: Any,
    ) -> Settings:
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
        settings = replace(settings, rows=check_rows(settings.rows), **changes)
        settings = settings._with_points() if settings.of_points else settings._with_structure()
        settings._check_held()
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
        """Whether they describe methods of points, not tableaux."""
        given = self.tree, self.flows, self.first_flows
        return self.registers or given != (None, None, None)

    def tree_for(self, flows: int, random: np.random.Generator) -> Layout:
        """Return the given tree, or one that is drawn at random."""
        options = {"embedded": self.embedded, "first_same_as_last": self.first_same_as_last}
        return self.tree or draw_layout(self.stages, flows, random, **options)

    def _with_structure(self) -> Settings:
        """Return the settings of tableaux, with the structure of constructions."""
        if self.first_same_as_last:
            raise ValueError("first_same_as_last needs flows; it is for commutator-free methods")
        order, stages, structure = self.order, self.stages, self.structure
        if structure is None:
            likely = likely_structure(order, stages, self.embedded)
            structure = Structure.GENERAL if self.hold else likely
        system = ConditionSystem.tableau(order, stages, self.rows, self.embedded, structure)
        return replace(self, structure=system.structure)

    def _with_points(self) -> Settings:
        """Return the settings of methods of points, with the layout of a given tree."""
        for name in ("rows", "structure", "first_stages"):
            if value := getattr(self, name):
                raise ValueError(f"{name} is for tableaux, got {value!r} with flows or a tree")
        settings = replace(self, structure=Structure.GENERAL)
        if not self.registers:
            return settings._with_flows() if self.tree is None else settings._with_tree()
        for name in ("tree", "flows", "first_same_as_last", "hold"):
            if getattr(self, name):
                raise ValueError(f"registers must be False with {name}")
        check_integer("stages", self.stages, 1 + self.embedded)
        return replace(settings, tree=register_chain(self.stages, self.order, self.embedded))

    def _with_flows(self) -> Settings:
        """Return the settings with the numbers of flows of trees that are drawn."""
        if self.hold:
            raise ValueError("hold needs a tableau or a tree, whose coefficients have names")
        if self.flows is None:
            raise ValueError("first_flows needs flows, the number of flows to reach")
        if self.first_same_as_last:
            check_integer("stages", self.stages, 2)
        least, most = self.stages - self.first_same_as_last, 10 * MAX_STAGES
        flows, first_flows = check_integer("flows", self.flows, least, most), None
        if self.kind == "construct":
            first_flows = flows if self.first_flows is None else self.first_flows
            first_flows = check_integer("first_flows", first_flows, flows, most)
        return replace(self, flows=flows, first_flows=first_flows)

    def _with_tree(self) -> Settings:
        """Return the settings with the layout of a given tree, and its number of flows."""
        if self.first_same_as_last:
            raise ValueError("first_same_as_last must be False with a tree")
        layout = layout_of(self.tree)
        if layout.stages != self.stages:
            given = f"{layout.stages}, got {self.stages}"
            raise ValueError(f"stages must be those of the tree, {given}")
        if self.embedded and not layout.pair:
            raise ValueError("embedded must be False, as tree has no second result")
        unused = "flows" if self.kind == "search" else "first_flows"
        if (value := getattr(self, unused)) is not None:
            raise ValueError(f"{unused} must be None with a tree, got {value!r}")
        if self.kind == "search":
            return replace(self, tree=layout)
        most = layout.flows
        least = len({START, *layout.stage_points, layout.results[0]}) - 1
        flows = most if self.flows is None else check_integer("flows", self.flows, least, most)
        return replace(self, tree=layout, flows=flows, first_flows=most, embedded=layout.pair)

    def _check_counts(self, force: bool) -> None:
        """Refuse methods with too few stages, flows or unknowns, unless `force` is true.

        Conditions on methods of points are counted where flows commute.
        """
        order, layout, stages = self.order, self.layout, self.stages - self.first_same_as_last
        conditions, kind = len(rooted_trees_through(order)), "conditions where flows commute"
        subject, structure = f"stages = {stages} gives", ""
        if layout is None:
            flows, size = self.flows or 0, most_unknowns(stages, self.flows or 0)
        else:
            system = self.system(layout)
            flows, size = layout.flows, system.movable.size
        if self.registers:
            conditions += len(rooted_trees_through(order - 1)) if self.embedded else 0
            subject += " two registers"
        elif self.of_points:
            subject, least = "the flows have", MIN_STAGES[order - 1]
            if stages < least:
                few = f"stages = {stages} is too few for order {order}, which needs {least}"
                refuse(force, f"{few} even where flows commute")
            if (order, flows) == (4, 4):
                few = "flows = 4 is too few for order 4, which needs 5"
                page = "see the page 'Methods that do not exist' of the documentation"
                refuse(force, f"{few}: {page}")
        else:
            conditions, kind = system.equations, "independent conditions"
            structure = f" with structure {self.structure.name}" * bool(self.structure)
        if size < conditions:
            subject = "hold leaves" if self.hold else subject
            few = f"{subject} {size} unknowns for {conditions} {kind} of order {order}"
            refuse(force, f"{few}{structure}")

    def _check_held(self) -> None:
        """Raise ValueError if a condition depends on held values alone, and isn't satisfied."""
        if not self.hold or self.layout is None:
            return
        system = self.system(self.layout)
        x = start_generator(0, 0).uniform(-1, 1, system.size)
        off = np.abs(system.residual(x)) > _RESIDUAL_ROUNDING
        if (lost := off & ~system.jacobian(x).any(axis=1)).any():
            tree = forest(self.order + 1).tree(int(system.conditions(True)[0][lost][0]))
            raise ValueError(
                f"hold allows no method of order {self.order}: the condition of tree {tree} "
                "depends on nothing else, and isn't satisfied"
            )

    def _for_search(self) -> Settings:
        """Return the settings of a search with defaults for None."""
        layout, lmdif = self.layout, self.algorithm == "lmdif"
        pair = self.embedded if layout is None else layout.pair
        for name, used in {"hold": self.hold, "registers": self.registers, "pairs": pair}.items():
            if lmdif and used:
                raise ValueError(f"algorithm must be 'minimum-norm' with {name}, got 'lmdif'")
        size = most_unknowns(self.stages, self.flows or 0)
        if layout is not None:
            size = layout.size - len(layout.fixed)
        by_order = (self.order > 4) + (self.order > 5)
        width = _TREE_WIDTH if self.of_points else _WIDTHS[by_order]
        width = 1.0 if lmdif else _REGISTER_WIDTH if self.registers else width
        maxfev = _TREE_EVALUATIONS if self.of_points else _EVALUATIONS[by_order]
        defaults = {
            "width": width,
            "maxfev": 200 * (size + 1) if lmdif else maxfev,
            "refine_maxfev": 20 * (size + 1),
        }
        given = {name: value for name in defaults if (value := getattr(self, name)) is not None}
        values = defaults | given
        return replace(
            self,
            width=check_real("width", values["width"], most=MAX_HALF_WIDTH),
            maxfev=check_integer("maxfev", values["maxfev"], 1, MAX_COUNT),
            refine_below=check_real("refine_below", self.refine_below),
            refine_maxfev=check_integer("refine_maxfev", values["refine_maxfev"], 1, MAX_COUNT),
        )

    def _for_construction(self) -> Settings:
        """Return the settings of a construction with defaults for None."""
        order, stages, first_stages = self.order, self.stages, self.first_stages
        if self.of_points:
            start = StartSettings(1, _TREE_WIDTH, 300 if order < 7 else 1500, 1e-14)
        else:
            start = default_start(order, self.structure, self.embedded)
        if first_stages is None:
            first_stages = stages if self.hold else max(stages, start.stages)
        first_stages = check_integer("first_stages", first_stages, stages, MAX_STAGES)
        if self.hold and (first_stages, self.first_flows) != (stages, self.flows):
            raise ValueError("hold: stages and flows can't be dropped")
        width = start.width if self.width is None else self.width
        iterations = start.iterations if self.iterations is None else self.iterations
        return replace(
            self,
            first_stages=first_stages,
            width=check_real("width", width, positive=True, most=MAX_HALF_WIDTH),
            iterations=check_integer("iterations", iterations, 1, MAX_COUNT),
            promising=start.promising,
            largest=check_real("largest", self.largest, positive=True),
            restarts=check_integer("restarts", self.restarts, 0),
        )


def refuse(force: bool, problem: str) -> None:
    """Raise ValueError for arguments that allow no method, unless `force` is true."""
    if not force:
        raise ValueError(f"{problem}; pass force=True to try nevertheless")
