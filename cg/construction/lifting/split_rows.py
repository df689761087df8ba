"""Rows of a flat tableau that are split into flows, and their order conditions.

The weights on a stage add up, along the path to each stage and to each result, to the entry of the
flat tableau. In each of these linear equations, the last weight on the path is the remainder that
the other weights leave; the others are the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

import numpy as np

from cg.construction.conditions import condition_trees
from cg.construction.layouts import Layout
from cg.construction.points import START
from cg.construction.search.shapes import draw_layout
from cg.construction.solvers.held import HeldValues
from cg.construction.solvers.system import ConditionSystem
from cg.support.quads import to_decimal

_DRAWS = 30_000  # tries to draw a tree that leads to given rows
_NEAR_RATIONAL, _MAX_DENOMINATOR = Fraction(1, 10**40), 10**5  # limits for rational numbers


@dataclass(frozen=True)
class FlatRows:
    """Rows of a flat tableau: those of ``a``, of length s, ``b``, and second weights or None."""

    stages: tuple[tuple[Fraction, ...], ...]
    result: tuple[Fraction, ...]
    embedded: tuple[Fraction, ...] | None = None

    @property
    def count(self) -> int:
        """Number of stages."""
        return len(self.stages)

    @cached_property
    def at_result(self) -> bool:
        """Whether the last stage is at the result, as its row is that of the result."""
        return self.count > 1 and self.stages[-1] == self.result

    @property
    def moved_stages(self) -> list[int]:
        """Stages with points of their own: all except the first, and one at the result."""
        return list(range(1, self.count - self.at_result))

    def ends(self, layout: Layout) -> list[tuple[int, tuple[Fraction, ...]]]:
        """Return the points of stages and results with their rows."""
        rows = [*self.stages, self.result]
        if self.embedded is not None:
            rows.append(self.embedded)
        return list(zip(layout.ends, rows, strict=True))

    def layout(
        self, parents: Sequence[int], at: Sequence[int], result: int, uses: Sequence[set[int]]
    ) -> Layout:
        """Return the layout with points, those of `moved_stages`, and one for a second result."""
        parents, weights = list(parents), [tuple(sorted(used)) for used in uses]
        stage_points = (START, *at, *([result] if self.at_result else []))
        results = [result]
        if self.embedded is not None:
            pairs = zip(self.result, self.embedded, strict=True)
            parents.append(result)
            weights.append(tuple(k for k, (b, second) in enumerate(pairs) if b != second))
            results.append(len(parents) - 1)
        return Layout(tuple(parents), tuple(weights), stage_points, tuple(results))


def chains_layout(rows: FlatRows, lengths: Sequence[int], *, zeros: bool = True) -> Layout:
    """Return the layout in which each moved stage and the result have chains of `lengths` flows.

    Without `zeros`, chains of several flows also have weights where the tableau has zeros.
    """
    parents: list[int] = []
    uses: list[set[int]] = []
    ends: list[int] = []
    targets = [
        *((k, rows.stages[k]) for k in rows.moved_stages),
        (1 + len(rows.moved_stages), rows.result),
    ]
    for (before, row), length in zip(targets, lengths, strict=True):
        first, free_zeros = len(parents), length > 1 and not zeros
        parents += [START, *range(first, first + length - 1)]
        uses += [{k for k in range(before) if row[k] or free_zeros}] * length
        ends.append(first + length - 1)
    return rows.layout(parents, ends[:-1], ends[-1], uses)


def random_layout(rows: FlatRows, flows: int, generator: np.random.Generator) -> Layout:
    """Return a random tree of points with a number of flows to the stages and the result.

    A flow has weights on the stages that a row further on contains. Trees whose weights can't add
    up to the rows are rejected; ValueError is raised if all are.
    """
    targets = [*(rows.stages[k] for k in rows.moved_stages), rows.result]
    for _ in range(_DRAWS):
        tree = draw_layout(rows.count, flows, generator, first_same_as_last=rows.at_result)
        ends = [*tree.stage_points[1 : len(targets)], flows - 1]
        paths = [tree.path(end) for end in ends]
        uses = []
        for m, known in enumerate(tree.weights):
            leading = [row for row, path in zip(targets, paths, strict=True) if m in path]
            uses.append({k for k in known if any(row[k] for row in leading)})
        if not all(uses):
            continue
        layout = rows.layout(tree.parents, ends[:-1], flows - 1, uses)
        try:
            HeldValues.solving(path_sums(rows, layout), layout.size)
        except ArithmeticError:  # no weights add up to the rows
            continue
        return layout
    raise ValueError(
        f"flows must be a number of which random trees lead to the rows of the tableau, got {flows}"
    )


def path_sums(rows: FlatRows, layout: Layout) -> list[tuple[frozenset[int], Fraction]]:
    """Return the sets of weights that lie on one path and multiply one stage, and their sums."""
    sums: dict[frozenset[int], Fraction] = {}
    for end, row in rows.ends(layout):
        on_path: dict[int, list[int]] = {k: [] for k in range(rows.count)}
        for m in layout.path(end):
            for index, k in enumerate(layout.weights[m], layout.starts[m]):
                on_path[k].append(index)
        for k, indices in on_path.items():
            if sums.setdefault(frozenset(indices), row[k] if indices else Fraction(0)) != row[k]:
                raise ArithmeticError("points can't lead to these rows")
    return [(indices, value) for indices, value in sums.items() if indices]


@dataclass(frozen=True)
class SplitRows(ConditionSystem):
    """The order conditions on a flat tableau that is split into flows.

    `embedded_order` is that of the second result, 0 without; `stage_orders` are the assumed orders
    of the stages at their abscissae.
    """

    flat: FlatRows = field(kw_only=True)
    embedded_order: int = field(default=0, kw_only=True)
    stage_orders: tuple[int, ...] = field(default=(), kw_only=True)

    @cached_property
    def held(self) -> HeldValues:
        """The sums that paths keep, solved for their last weights, the remainders."""
        return HeldValues.solving(path_sums(self.flat, self.layout), self.size)

    @property
    def orders(self) -> tuple[int, ...]:
        """The orders of the results."""
        return (self.order, self.embedded_order)[: 1 + self.layout.pair]

    @property
    def assumptions(self) -> list[tuple[int, int]]:
        """The trees of the assumed orders of stages, and the stages, from 1."""
        # order two follows from the sums of weights
        orders = {k: order for k, order in enumerate(self.stage_orders, 1) if order > 2}
        return [
            (tree, stage)
            for stage, order in orders.items()
            for tree in condition_trees(min(order, self.order - 1), independent=True)
        ]

    def texts(self, x: Sequence[Fraction]) -> list[str]:
        """Return weights whose sums are exact: unknowns are rounded, and remainders follow."""
        texts = list(map(_as_written, x))
        exact = self.complete([Fraction(text) for text in texts])
        for k in self.held.pivots.tolist():
            texts[k] = str(exact[k])
        return texts


def _as_written(value: Fraction) -> str:
    """Return a value as a decimal, or as the rational number that it is to all digits."""
    simple = value.limit_denominator(_MAX_DENOMINATOR)
    return str(simple) if abs(value - simple) <= _NEAR_RATIONAL else to_decimal(value)
