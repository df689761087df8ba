"""Settings of a random search, and the check of the arguments that make them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cg.construction.conditions import Rows, check_rows, count, unknowns
from cg.construction.layouts.layout import Layout
from cg.construction.search.shapes import ShapeSettings, most_unknowns
from cg.support.checks import MAX_COUNT, MAX_HALF_WIDTH, check_integer, check_real

ALGORITHMS = ("minimum-norm", "lmdif")

# Half-widths of guesses and numbers of evaluations with which the minimum-norm solver found most
# methods per second, by order.
_BEST_WIDTHS = {1: 1.0, 2: 1.0, 3: 1.0, 4: 1.0, 5: 0.75}
_WIDTH_ABOVE = 0.3
_BEST_BOUNDS = {1: 120, 2: 120, 3: 120, 4: 120, 5: 500}
_BOUND_ABOVE = 1000

_TREE_WIDTH = 0.4
_TREE_BOUND = 600


@dataclass(frozen=True, kw_only=True)
class SearchSettings(ShapeSettings):
    """The arguments of `cg.search` that determine its result."""

    algorithm: str
    rows: Rows
    maxfev: int
    refine_below: float
    refine_maxfev: int

    def checked(self, force: bool) -> SearchSettings:
        """Return the settings, checked, with defaults for None."""
        if not isinstance(self.algorithm, str) or self.algorithm not in ALGORITHMS:
            names = ", ".join(ALGORITHMS)
            raise ValueError(f"algorithm must be one of {names}, got {self.algorithm!r}")
        rows = check_rows(self.rows)
        layout, flows, size = self._check_shape(rows, force)
        lmdif = self.algorithm == "lmdif"
        if lmdif and self.hold:
            raise ValueError("algorithm must be 'minimum-norm' with hold, got 'lmdif'")
        self.check_held(layout if self.of_points else Layout.tableau(self.stages, rows), force)
        width, maxfev, refine_maxfev = self.width, self.maxfev, self.refine_maxfev
        if width is None:
            best = _TREE_WIDTH if self.of_points else _BEST_WIDTHS.get(self.order, _WIDTH_ABOVE)
            width = 1.0 if lmdif else best
        if maxfev is None:
            bound = _TREE_BOUND if self.of_points else _BEST_BOUNDS.get(self.order, _BOUND_ABOVE)
            maxfev = 200 * (size + 1) if lmdif else bound
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
        if not self.of_points:
            self.check_tableau()
            size, conditions = unknowns(stages, rows), count(order, independent=True)
            if not force and size < conditions:
                raise ValueError(
                    f"stages = {stages} gives {size} unknowns ({rows.name.lower()} rows) for "
                    f"{conditions} independent conditions of order {order}; pass force=True to "
                    "try nevertheless"
                )
            return None, None, size
        layout, flows = self.check_layout(force)
        if rows is not Rows.EXPLICIT:
            raise ValueError(f"rows must be explicit with a tree, got {rows.name.lower()}")
        if self.algorithm == "lmdif" and (self.embedded or (layout is not None and layout.pair)):
            raise ValueError("algorithm must be 'minimum-norm' for pairs, got 'lmdif'")
        return layout, flows, most_unknowns(stages, flows) if layout is None else layout.size
