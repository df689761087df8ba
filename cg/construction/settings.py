"""Settings of a construction, and the check of the arguments that make them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from cg.construction.layouts.layout import Layout
from cg.construction.layouts.points import START
from cg.construction.search.shapes import ShapeSettings
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.construction.start import default_start, likely_structure, tree_start
from cg.support.checks import (
    MAX_COUNT,
    MAX_HALF_WIDTH,
    MAX_STAGES,
    check_flag,
    check_integer,
    check_real,
)


@dataclass(frozen=True, kw_only=True)
class ConstructionSettings(ShapeSettings):
    """The arguments of `construct` that determine its result, and how its starts are solved."""

    structure: Structure
    first_stages: int
    iterations: int
    promising: float = 0.0
    largest: float
    restarts: int
    full_rank: bool
    first_flows: int | None = None

    @property
    def of_points(self) -> bool:
        """Whether they describe a method of points, not a tableau."""
        return super().of_points or self.first_flows is not None

    def system(self, layout: Layout) -> ConditionSystem:
        """Return the conditions on methods of a layout."""
        return ConditionSystem(self.order, layout, self.structure, self.hold)

    def checked(self, force: bool) -> ConstructionSettings:
        """Return the settings, checked, with defaults for None."""
        order, stages = self.order, self.stages
        full_rank = check_flag("full_rank", self.full_rank)
        if self.of_points:
            start, shape = tree_start(order), self._check_tree(force)
        else:
            structure = self._check_structure(force)
            start = default_start(order, structure)
            first_stages = self.first_stages
            if first_stages is None:
                first_stages = stages if self.hold else max(stages, start.stages)
            first_stages = check_integer("first_stages", first_stages, stages, MAX_STAGES)
            shape = {"structure": structure, "first_stages": first_stages, "embedded": False}
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
            full_rank=full_rank,
            **shape,
        )

    def _check_structure(self, force: bool) -> Structure:
        """Return the simplifying assumptions of a tableau."""
        self.check_tableau()
        order, stages, full_rank = self.order, self.stages, self.full_rank
        structure = self.structure
        if structure is None:
            general = full_rank or self.hold
            structure = Structure.GENERAL if general else likely_structure(order, stages)
        system = ConditionSystem.tableau(order, stages, structure=structure)
        structure = system.structure
        if full_rank and structure:
            raise ValueError(f"structure must be GENERAL with full_rank, got {structure.name}")
        if not force and system.movable.size < system.equations:
            kind = f" with structure {structure.name}" if structure else ""
            raise ValueError(
                f"stages = {stages} gives {system.movable.size} unknowns for {system.equations} "
                f"independent conditions of order {order}{kind}; pass force=True to try "
                "nevertheless"
            )
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
