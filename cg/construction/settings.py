"""What a construction does: its settings, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..structure.layout import Layout
from ..structure.points import START
from ..support.checks import (
    MAX_COUNT,
    MAX_HALF_WIDTH,
    MAX_STAGES,
    check_flag,
    check_integer,
    check_real,
)
from .search.shapes import check_order, check_points
from .solvers.system import ConditionSystem, Structure
from .start import default_start, likely_structure, tree_start

__all__ = ["ConstructionSettings", "tableau_settings", "tree_settings"]


@dataclass(frozen=True)
class ConstructionSettings:
    """What a construction does; see `construct`."""

    order: int
    stages: int
    seed: int
    structure: Structure
    first_stages: int
    width: float
    iterations: int
    promising: float
    largest: float
    restarts: int
    full_rank: bool
    flows: int | None = None
    first_flows: int | None = None
    embedded: bool = False
    tree: Layout | None = None
    first_same_as_last: bool = False


def tableau_settings(
    order: int,
    stages: int,
    seed: int,
    largest: float,
    restarts: int,
    full_rank: bool,
    structure: Structure | None,
    first_stages: int | None,
    width: float | None,
    iterations: int | None,
    force: bool,
) -> ConstructionSettings:
    """Return the settings for a tableau, from arguments of `construct`."""
    order = check_order(order)
    stages = check_integer("stages", stages, 1, MAX_STAGES)
    full_rank = check_flag("full_rank", full_rank)
    if structure is None:
        structure = Structure.GENERAL if full_rank else likely_structure(order, stages)
    system = ConditionSystem.tableau(order, stages, structure=structure)
    if full_rank and system.structure:
        raise ValueError(f"structure must be GENERAL with full_rank, got {system.structure.name}")
    if not check_flag("force", force) and system.free.size < system.equations:
        kind = f" with structure {system.structure.name}" if system.structure else ""
        raise ValueError(
            f"stages = {stages} gives {system.free.size} unknowns for {system.equations} "
            f"independent conditions of order {order}{kind}; pass force=True to try all the same"
        )
    start = default_start(order, system.structure)
    if first_stages is None:
        first_stages = max(stages, start.stages)
    first_stages = check_integer("first_stages", first_stages, stages, MAX_STAGES)
    if width is None:
        width = start.width
    if iterations is None:
        iterations = start.iterations
    return ConstructionSettings(
        order,
        stages,
        check_integer("seed", seed, 0),
        system.structure,
        first_stages,
        check_real("width", width, positive=True, most=MAX_HALF_WIDTH),
        check_integer("iterations", iterations, 1, MAX_COUNT),
        start.promising,
        check_real("largest", largest, positive=True),
        check_integer("restarts", restarts, 0),
        full_rank,
    )


def tree_settings(
    order: int,
    stages: int,
    seed: int,
    largest: float,
    restarts: int,
    full_rank: bool,
    structure: Structure | None,
    first_stages: int | None,
    width: float | None,
    iterations: int | None,
    force: bool,
    tree: Any,
    flows: int | None,
    first_flows: int | None,
    embedded: bool,
    first_same_as_last: bool,
) -> ConstructionSettings:
    """Return the settings for a method of points, from arguments of `construct`."""
    order = check_order(order)
    stages = check_integer("stages", stages, 1, MAX_STAGES)
    for name, value in (("structure", structure), ("first_stages", first_stages)):
        if value:
            raise ValueError(f"{name} is for tableaux, got {value!r} with a tree")
    if flows is None and tree is None:
        raise ValueError("first_flows needs a number of flows to come down to")
    force = check_flag("force", force)
    given = flows if tree is None else None
    layout, most = check_points(order, stages, tree, given, embedded, force, first_same_as_last)
    if layout is not None:
        if first_flows is not None:
            raise ValueError(f"first_flows must be None with a tree, got {first_flows!r}")
        embedded = layout.pair
        first_flows = most - embedded
        least = len({START, *layout.stage_points, layout.results[0]}) - 1
        flows = first_flows if flows is None else check_integer("flows", flows, least, first_flows)
    else:
        flows, first_flows = most, most if first_flows is None else first_flows
    start = tree_start(order)
    return ConstructionSettings(
        order,
        stages,
        check_integer("seed", seed, 0),
        Structure.GENERAL,
        stages,
        check_real(
            "width", start.width if width is None else width, positive=True, most=MAX_HALF_WIDTH
        ),
        check_integer(
            "iterations", start.iterations if iterations is None else iterations, 1, MAX_COUNT
        ),
        start.promising,
        check_real("largest", largest, positive=True),
        check_integer("restarts", restarts, 0),
        check_flag("full_rank", full_rank),
        flows,
        check_integer("first_flows", first_flows, flows, 10 * MAX_STAGES),
        check_flag("embedded", embedded),
        layout,
        check_flag("first_same_as_last", first_same_as_last),
    )
