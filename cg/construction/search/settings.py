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

    def system(self, layout: Layout) -> ConditionSystem:
        """Return the conditions on methods of a layout."""
        return ConditionSystem(self.order, layout, self.structure, self.hold, self.registers)

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
        if kind == "search":
            check_choice("algorithm", settings.algorithm, ALGORITHMS)
            if check_flag("registers", settings.registers):
                settings = replace(settings, tree=settings._check_registers(force))
            return settings._checked_search(check_rows(settings.rows), force)
        return settings._checked_construction(force)

    def check_held(self, layout: Layout | None, force: bool) -> None:
        """Raise ValueError if a condition, or their number, can't be satisfied by free unknowns."""
        if not self.hold:
            return
        if layout is None:
            raise ValueError("hold needs a tableau or a tree, whose coefficients have names")
        system = self.system(layout)
        x = start_generator(0, 0).uniform(-1, 1, system.size)
        off = np.abs(system.residual(x)) > _RESIDUAL_ROUNDING
        if (lost := off & ~system.jacobian(x).any(axis=1)).any():
            tree = forest(self.order + 1).tree(int(system.conditions(True)[0][lost][0]))
            raise ValueError(
                f"hold allows no method of order {self.order}: the condition of tree {tree} "
                "depends on nothing else, and isn't satisfied"
            )
        flat = len(rooted_trees_through(self.order))  # conditions where flows commute
        conditions = flat if system.rows is None else system.equations
        if system.movable.size < conditions:
            refuse(
                force,
                f"hold leaves {system.movable.size} unknowns for {conditions} conditions of order "
                f"{self.order}",
            )

    @property
    def layout(self) -> Layout | None:
        """The layout of all methods; None if trees are drawn."""
        if self.of_points:
            return self.tree
        return Layout.tableau(self.stages, self.rows, self.embedded)

    @property
    def of_points(self) -> bool:
        """Whether they describe methods of points, not tableaux."""
        return not (self.tree is None and self.flows is None and self.first_flows is None)

    def check_tableau(self) -> bool:
        """Return `embedded`; ValueError if an argument is only for methods of points."""
        if check_flag("first_same_as_last", self.first_same_as_last):
            raise ValueError("first_same_as_last needs flows; it is for commutator-free methods")
        return check_flag("embedded", self.embedded)

    def check_layout(self, force: bool) -> tuple[Layout | None, int]:
        """Return the layout of a given tree, None if trees are drawn, and the number of flows.

        Unless `force` is true, shapes are refused that can't have the order where flows commute.
        """
        embedded, flows, stages = check_flag("embedded", self.embedded), self.flows, self.stages
        last = int(check_flag("first_same_as_last", self.first_same_as_last))
        layout = None
        if self.tree is not None:
            if last:
                raise ValueError("first_same_as_last must be False with a tree")
            if flows is not None:
                raise ValueError(f"flows must be None with a tree, got {flows!r}")
            layout = layout_of(self.tree)
            if layout.stages != stages:
                raise ValueError(f"stages must be those of the tree, {layout.stages}, got {stages}")
            if embedded and not layout.pair:
                raise ValueError("embedded must be False, as tree has no second result")
            flows, unknowns = len(layout.parents), layout.size
        else:
            if last:
                check_integer("stages", stages, 2)
            flows = check_integer("flows", flows, stages - last, 10 * MAX_STAGES)
            unknowns = most_unknowns(stages - last, flows)
        if not force:
            second = 0 if layout is None else int(layout.pair)
            _check_counts(self.order, stages - last, flows - second, unknowns)
        return layout, flows

    def tree_for(self, flows: int, random: np.random.Generator) -> Layout:
        """Return the given tree, or one that is drawn at random."""
        options = {"embedded": self.embedded, "first_same_as_last": self.first_same_as_last}
        return self.tree or draw_layout(self.stages, flows, random, **options)

    def _check_registers(self, force: bool) -> Layout:
        """Return the chain of a two-register method."""
        for name in ("tree", "flows", "first_same_as_last", "hold"):
            if getattr(self, name):
                raise ValueError(f"registers must be False with {name}")
        pair = check_flag("embedded", self.embedded)
        layout = register_chain(check_integer("stages", self.stages, 1 + pair), self.order, pair)
        system = self.system(layout)
        conditions = len(rooted_trees_through(self.order))
        if layout.pair:
            conditions += len(rooted_trees_through(self.order - 1))
        if system.movable.size < conditions:
            refuse(
                force,
                f"stages = {self.stages} gives two registers {system.movable.size} unknowns for "
                f"{conditions} conditions of order {self.order}",
            )
        return layout

    def _checked_search(self, rows: Rows, force: bool) -> Settings:
        """Return the settings of a search with defaults for None."""
        layout, flows, size = self._check_shape(rows, force)
        lmdif = self.algorithm == "lmdif"
        if lmdif and (self.hold or self.registers):
            other = "hold" if self.hold else "registers"
            raise ValueError(f"algorithm must be 'minimum-norm' with {other}, got 'lmdif'")
        self.check_held(replace(self, rows=rows, tree=layout).layout, force)
        width, maxfev, refine_maxfev = self.width, self.maxfev, self.refine_maxfev
        by_order = (self.order > 4) + (self.order > 5)
        if width is None:
            best = _TREE_WIDTH if self.of_points else _WIDTHS[by_order]
            best = _REGISTER_WIDTH if self.registers else best
            width = 1.0 if lmdif else best
        if maxfev is None:
            best = _TREE_EVALUATIONS if self.of_points else _EVALUATIONS[by_order]
            maxfev = 200 * (size + 1) if lmdif else best
        if refine_maxfev is None:
            refine_maxfev = 20 * (size + 1)
        return replace(
            self,
            width=check_real("width", width, most=MAX_HALF_WIDTH),
            flows=flows if layout is None else None,
            embedded=bool(self.embedded),
            tree=layout,
            first_same_as_last=bool(self.first_same_as_last),
            rows=rows,
            maxfev=check_integer("maxfev", maxfev, 1, MAX_COUNT),
            refine_below=check_real("refine_below", self.refine_below),
            refine_maxfev=check_integer("refine_maxfev", refine_maxfev, 1, MAX_COUNT),
        )

    def _check_shape(self, rows: Rows, force: bool) -> tuple[Layout | None, int | None, int]:
        """Return the layout of a given tree, the number of flows, and that of unknowns."""
        order, stages = self.order, self.stages
        layout = flows = None
        if self.of_points:
            layout, flows = self.check_layout(force)
            size = most_unknowns(stages, flows) if layout is None else layout.size
            if rows is not Rows.EXPLICIT:
                raise ValueError(f"rows must be explicit with a tree, got {rows.name.lower()}")
        else:
            system = ConditionSystem.tableau(order, stages, rows, self.check_tableau())
            size = system.movable.size
            _check_unknowns(system, force, f" ({rows.name.lower()} rows)")
        if self.algorithm == "lmdif" and (self.embedded or (layout and layout.pair)):
            raise ValueError("algorithm must be 'minimum-norm' for pairs, got 'lmdif'")
        return layout, flows, size

    def _checked_construction(self, force: bool) -> Settings:
        """Return the settings of a construction."""
        order, stages = self.order, self.stages
        if self.of_points:
            start = StartSettings(1, _TREE_WIDTH, 300 if order < 7 else 1500, 1e-14)
            shape = self._check_tree(force)
        else:
            structure = self._check_structure(force)
            start = default_start(order, structure, self.embedded)
            first_stages = self.first_stages
            if first_stages is None:
                first_stages = stages if self.hold else max(stages, start.stages)
            first_stages = check_integer("first_stages", first_stages, stages, MAX_STAGES)
            shape = {"structure": structure, "first_stages": first_stages}
        steps = shape["first_stages"] - stages, shape.get("first_flows") != shape.get("flows")
        if self.hold and any(steps):
            raise ValueError("hold: stages and flows can't be dropped")
        width = start.width if self.width is None else self.width
        iterations = start.iterations if self.iterations is None else self.iterations
        return replace(
            self,
            width=check_real("width", width, positive=True, most=MAX_HALF_WIDTH),
            iterations=check_integer("iterations", iterations, 1, MAX_COUNT),
            promising=start.promising,
            largest=check_real("largest", self.largest, positive=True),
            restarts=check_integer("restarts", self.restarts, 0),
            **shape,
        )

    def _check_structure(self, force: bool) -> Structure:
        """Return the simplifying assumptions of a tableau."""
        embedded = self.check_tableau()
        order, stages = self.order, self.stages
        structure = self.structure
        if structure is None and self.hold:
            structure = Structure.GENERAL
        elif structure is None:
            structure = likely_structure(order, stages, embedded)
        system = ConditionSystem.tableau(order, stages, embedded=embedded, structure=structure)
        structure = system.structure
        _check_unknowns(system, force)
        replace(self, structure=structure).check_held(system.layout, force)
        return structure

    def _check_tree(self, force: bool) -> dict[str, Any]:
        """Return the settings that only methods of points have."""
        for name, value in (("structure", self.structure), ("first_stages", self.first_stages)):
            if value:
                raise ValueError(f"{name} is for tableaux, got {value!r} with a tree")
        if self.flows is None and self.tree is None:
            raise ValueError("first_flows needs flows, the number of flows to reach")
        shape = self if self.tree is None else replace(self, flows=None)
        layout, most = shape.check_layout(force)
        embedded, flows, first_flows = self.embedded, self.flows, self.first_flows
        if layout is None:
            flows, first_flows = most, most if first_flows is None else first_flows
        else:
            if first_flows is not None:
                raise ValueError(f"first_flows must be None with a tree, got {first_flows!r}")
            embedded = layout.pair
            first_flows = most - embedded
            least = len({START, *layout.stage_points, layout.results[0]}) - 1
            flows = check_integer(
                "flows", first_flows if flows is None else flows, least, first_flows
            )
        shape.check_held(layout, force)
        return {
            "structure": Structure.GENERAL,
            "first_stages": self.stages,
            "flows": flows,
            "first_flows": check_integer("first_flows", first_flows, flows, 10 * MAX_STAGES),
            "embedded": check_flag("embedded", embedded),
            "tree": layout,
            "first_same_as_last": check_flag("first_same_as_last", self.first_same_as_last),
        }


def refuse(force: bool, problem: str) -> None:
    """Raise ValueError for arguments that allow no method, unless `force` is true."""
    if not force:
        raise ValueError(f"{problem}; pass force=True to try nevertheless")


def _check_unknowns(system: ConditionSystem, force: bool, kind: str = "") -> None:
    """Refuse tableaux with fewer unknowns than independent conditions."""
    size, equations = system.movable.size, system.equations
    structure = f" with structure {system.structure.name}" if system.structure else ""
    if size < equations:
        refuse(
            force,
            f"stages = {system.stages} gives {size} unknowns{kind} for {equations} independent "
            f"conditions of order {system.order}{structure}",
        )


def _check_counts(order: int, stages: int, flows: int, unknowns: int) -> None:
    """Refuse methods of points that can't have the order where flows commute."""
    least, conditions = MIN_STAGES[order - 1], len(rooted_trees_through(order))
    where = "where flows commute"
    if stages < least:
        few = f"stages = {stages} is too few for order {order}, which needs {least}"
        refuse(False, f"{few} even {where}")
    if (order, flows) == (4, 4):
        few = "flows = 4 is too few for order 4, which needs 5"
        refuse(False, f"{few}: see the page 'Methods that do not exist' of the documentation")
    if unknowns < conditions:
        few = f"the flows have {unknowns} unknowns for {conditions} conditions of order {order}"
        refuse(False, f"{few} {where}")
