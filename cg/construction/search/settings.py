"""What a search does: its settings, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...conditions import Rows, check_rows, count, unknowns
from ...structure.layout import Layout
from ...support.checks import (
    MAX_COUNT,
    MAX_HALF_WIDTH,
    MAX_STAGES,
    check_flag,
    check_integer,
    check_real,
)
from .shapes import check_order, check_points, most_unknowns

__all__ = ["SearchSettings", "checked_settings"]

ALGORITHMS = ("minimum-norm", "lmdif")

# Half the side of the cube of guesses, and evaluations allowed, by order: where the fast solver
# was measured to find most methods a second. Starts that are going to succeed do so early.
_BEST_WIDTHS = {1: 1.0, 2: 1.0, 3: 1.0, 4: 1.0, 5: 0.75}
_WIDTH_ABOVE = 0.3
_BEST_BOUNDS = {1: 120, 2: 120, 3: 120, 4: 120, 5: 500}
_BOUND_ABOVE = 1000

_TREE_WIDTH = 0.4
_TREE_BOUND = 600


@dataclass(frozen=True)
class SearchSettings:
    """What a search does; equal settings give equal results.

    See `cg.search` for the parameters.
    """

    order: int
    stages: int
    seed: int
    algorithm: str
    rows: Rows
    width: float
    maxfev: int
    refine_below: float
    refine_maxfev: int
    flows: int | None = None
    embedded: bool = False
    tree: Layout | None = None
    first_same_as_last: bool = False


def checked_settings(
    order: int,
    stages: int,
    seed: int,
    algorithm: str,
    rows: Rows | str,
    width: float | None,
    maxfev: int | None,
    refine_below: float,
    refine_maxfev: int | None,
    force: bool,
    tree: Any,
    flows: int | None,
    embedded: bool,
    first_same_as_last: bool,
) -> SearchSettings:
    """Return the settings of a search from the arguments of `cg.search`, checked."""
    order = check_order(order)
    stages = check_integer("stages", stages, 1, MAX_STAGES)
    seed = check_integer("seed", seed, 0)
    if not isinstance(algorithm, str) or algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm must be one of {', '.join(ALGORITHMS)}, got {algorithm!r}")
    rows = check_rows(rows)
    force = check_flag("force", force)
    size, conditions = unknowns(stages, rows), count(order, independent=True)
    layout = None
    of_points = tree is not None or flows is not None
    if of_points:
        layout, flows = check_points(
            order, stages, tree, flows, embedded, force, first_same_as_last
        )
        size = most_unknowns(stages, flows) if layout is None else layout.size
        if rows is not Rows.EXPLICIT:
            raise ValueError(f"rows must be explicit with a tree, got {rows.name.lower()}")
        if algorithm == "lmdif" and (embedded or (layout is not None and layout.pair)):
            raise ValueError("algorithm must be 'minimum-norm' for pairs, got 'lmdif'")
    elif check_flag("embedded", embedded):
        raise ValueError("embedded needs a number of flows, got a search for tableaux")
    elif check_flag("first_same_as_last", first_same_as_last):
        raise ValueError("first_same_as_last needs a number of flows, got a search for tableaux")
    elif not force and size < conditions:
        raise ValueError(
            f"stages = {stages} gives {size} unknowns ({rows.name.lower()} rows) for {conditions} "
            f"independent conditions of order {order}; pass force=True to try all the same"
        )
    if width is None:
        best_width = _TREE_WIDTH if of_points else _BEST_WIDTHS.get(order, _WIDTH_ABOVE)
        width = 1.0 if algorithm == "lmdif" else best_width
    width = check_real("width", width, most=MAX_HALF_WIDTH)
    refine_below = check_real("refine_below", refine_below)
    if maxfev is None:
        best = _TREE_BOUND if of_points else _BEST_BOUNDS.get(order, _BOUND_ABOVE)
        maxfev = 200 * (size + 1) if algorithm == "lmdif" else best
    maxfev = check_integer("maxfev", maxfev, 1, MAX_COUNT)
    if refine_maxfev is None:
        refine_maxfev = 20 * (size + 1)
    refine_maxfev = check_integer("refine_maxfev", refine_maxfev, 1, MAX_COUNT)
    return SearchSettings(
        order,
        stages,
        seed,
        algorithm,
        rows,
        width,
        maxfev,
        refine_below,
        refine_maxfev,
        flows if layout is None else None,
        bool(embedded),
        layout,
        bool(first_same_as_last),
    )
