"""Trees of points for a search: given by their parents and stages, or drawn at random."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions.counts import check_order
from cg.construction.layouts.layout import Layout
from cg.construction.layouts.points import START, MethodError, Point, PointTree, check_tree
from cg.construction.methods.commutator_free import as_index
from cg.construction.solvers.held import Hold, read_hold
from cg.construction.solvers.system import ConditionSystem
from cg.construction.trees.ordered import forest
from cg.construction.trees.rooted import rooted_trees_through
from cg.support.checks import MAX_STAGES, check_flag, check_integer

MIN_STAGES = (1, 2, 3, 4, 6, 7, 9, 11)
"""Smallest numbers of stages of explicit methods of orders 1, 2, ... where flows commute [1]_.

References
----------
.. [1] J. C. Butcher, Numerical Methods for Ordinary Differential Equations, 3rd ed., 2016,
   Section 324.
"""

_FIXED_FIRST = (0.2, 0.8)  # range of the first weight of a tree, fixed while solving
_FIXED_LAST = (0.1, 0.2)  # range of the last weight of an estimate, fixed while solving
_FIXED_FROM = 5  # lowest order for which the first weight is fixed
_ROUNDING = 1e-12  # error of residuals
_BACK = 0.3  # probability that a flow starts from a random earlier point, not the last one


def layout_of(tree: Any) -> Layout:
    """Return the layout of a tree of points, as `cg.search` takes it."""
    if isinstance(tree, Layout):
        layout = tree
    elif isinstance(getattr(tree, "tree", None), PointTree):
        check_tree(tree.tree)
        return Layout.of_tree(tree.tree)
    else:
        layout = _layout_of_places(tree)
    if layout.rows is not None:
        raise MethodError("tree must be one of points, got the layout of a tableau")
    check_tree(layout.tree([1] * layout.size))  # type: ignore[list-item]
    return layout


def _layout_of_places(tree: Any) -> Layout:
    expected = "a PointTree, or its parents, the points of stages and optional results"
    if isinstance(tree, str | bytes) or not isinstance(tree, Sequence):
        raise TypeError(f"tree must be {expected}, got {tree!r}")
    if not 2 <= len(tree) <= 4:
        raise TypeError(f"tree must be {expected}, got {len(tree)} entries")
    parents, stage_points = _indices("parents", tree[0]), _indices("stage_points", tree[1])
    results = tuple(as_index(end) for end in tree[2:]) or (len(parents) - 1,)
    # checked with weights on the first stage only: other weights need valid stage points
    points = tuple(Point(parent, {0: 1} if stage_points else {}) for parent in parents)  # type: ignore[dict-item]
    check_tree(PointTree(points, stage_points, *results))
    return _with_all_weights(parents, stage_points, results)


def _with_all_weights(
    parents: Sequence[int], stage_points: Sequence[int], results: Sequence[int]
) -> Layout:
    """Return the layout in which each flow has weights on all stages before it."""
    weights = tuple(
        tuple(stage for stage, at in enumerate(stage_points) if at < m) for m in range(len(parents))
    )
    return Layout(tuple(parents), weights, tuple(stage_points), tuple(results))


def _indices(label: str, values: Any) -> tuple[Any, ...]:
    if isinstance(values, str | bytes) or not isinstance(values, Sequence | np.ndarray):
        raise TypeError(f"{label} of tree must be a sequence of integers, got {values!r}")
    return tuple(map(as_index, values))


def draw_layout(
    stages: int,
    flows: int,
    random: np.random.Generator,
    *,
    embedded: bool = False,
    first_same_as_last: bool = False,
) -> Layout:
    """Draw a random tree of points, in which every point leads to a stage or the result.

    Each flow has weights on all stages before it. `flows` is at least `stages`: all stages but the
    first have points of their own, and the result is one more.
    """
    inner, ends = flows - 1, stages - first_same_as_last
    while True:
        places = [0, *(1 + random.permutation(max(0, inner - 1))[: max(0, ends - 2)])]
        at = sorted(int(m) for m in places[: ends - 1])
        back = random.random(flows) < _BACK
        parents = [int(random.integers(START, m)) if back[m] else m - 1 for m in range(flows)]
        if {*at, *parents, inner} >= set(range(flows)):
            break
    results = [inner]
    if embedded:
        parents.append(inner)
        results.append(flows)
    stage_points = (START, *at, *([inner] if first_same_as_last else []))
    return _with_all_weights(parents, stage_points, results)


def layout_of_fields(fields: Mapping[str, Any]) -> Layout:
    """Return the layout of a tree that `dataclasses.asdict` made fields of."""
    return Layout(
        tuple(fields["parents"]),
        tuple(map(tuple, fields["weights"])),
        tuple(fields["stage_points"]),
        tuple(fields["results"]),
    )


def select_points(
    layout: Layout,
    parents: Sequence[int],
    weights: Sequence[dict[int, float]],
    stage_points: Sequence[int],
    points: Sequence[int],
) -> tuple[Layout, NDArray[np.float64]]:
    """Return the layout of some `points` of a tree, numbered anew, and their packed weights."""
    number = {START: START} | {m: k for k, m in enumerate(points)}
    rows = [dict(sorted(weights[m].items())) for m in points]
    smaller = Layout(
        tuple(number[parents[m]] for m in points),
        tuple(tuple(row) for row in rows),
        tuple(number[m] for m in stage_points),
        tuple(number[m] for m in layout.results),
    )
    return smaller, np.array([weight for row in rows for weight in row.values()])


def merge_point(
    layout: Layout, x: Sequence[float], point: int
) -> tuple[Layout, NDArray[np.float64]]:
    """Return the layout without a point that is neither a stage nor a result, and its weights."""
    parents, weights = list(layout.parents), layout.point_weights(x)
    for m, parent in enumerate(layout.parents):
        if parent == point:
            parents[m] = layout.parents[point]
            for stage, weight in weights[point].items():
                weights[m][stage] = weights[m].get(stage, 0.0) + weight
    points = [m for m in range(len(parents)) if m != point]
    return select_points(layout, parents, weights, layout.stage_points, points)


def fixed_weights(order: int, layout: Layout) -> list[int]:
    """Return the indices of the weights of a tree to hold fixed while solving from a random start.

    From order 5 on, the first weight keeps the solver away from degenerate limits where it tends to
    zero. The conditions on a last flow to a second result are homogeneous in its weights, so that
    one of them is fixed to determine its length.
    """
    if layout.rows is not None:
        return []
    fixed = [0] if order >= _FIXED_FROM else []
    last = len(layout.parents) - 1
    if layout.pair and layout.results[1] == last and layout.parents[last] == layout.results[0]:
        fixed.append(layout.size - 1)
    return fixed


def draw_guess(
    order: int, layout: Layout, width: float, random: np.random.Generator
) -> NDArray[np.float64]:
    """Return random coefficients, uniform in [-width, width] except for fixed ones of trees."""
    guess = random.uniform(-width, width, layout.size)
    for k in fixed_weights(order, layout):
        guess[k] = random.uniform(*(_FIXED_LAST if k else _FIXED_FIRST))
    return guess


def most_unknowns(stages: int, flows: int) -> int:
    """Return the largest number of weights of a drawn tree, without those to a second result."""
    return sum(min(m + 1, stages) for m in range(flows))


@dataclass(frozen=True, kw_only=True)
class ShapeSettings:
    """Settings of `cg.search` and `cg.construct` for the shape of methods and their guesses."""

    order: int
    stages: int
    seed: int
    width: float
    flows: int | None = None  # None for tableaux
    embedded: bool = False
    tree: Layout | None = None  # None for tableaux and trees drawn at random
    first_same_as_last: bool = False
    hold: Hold = ()

    def system(self, layout: Layout) -> ConditionSystem:
        """Return the conditions on methods of a layout."""
        return ConditionSystem(self.order, layout, hold=self.hold)

    @classmethod
    def of(
        cls, order: int, stages: int, seed: int, hold: Mapping[str, Any] | None, **others: Any
    ) -> Self:
        """Return the settings of the arguments of a function, of which these four are checked."""
        return cls(
            order=check_order(order),
            stages=check_integer("stages", stages, 1, MAX_STAGES),
            seed=check_integer("seed", seed, 0),
            hold=() if hold is None else read_hold(hold),
            **others,
        )

    def check_held(self, layout: Layout | None, force: bool) -> None:
        """Raise ValueError if a condition, or their number, can't be satisfied by free unknowns."""
        if not self.hold:
            return
        if layout is None:
            raise ValueError("hold needs a tableau or a tree, whose coefficients have names")
        system = self.system(layout)
        x = start_generator(0, 0).uniform(-1, 1, system.size)
        off = np.abs(system.residual(x)) > _ROUNDING
        if (lost := off & ~system.jacobian(x).any(axis=1)).any():
            tree = forest(self.order + 1).tree(int(system.conditions(True)[0][lost][0]))
            raise ValueError(
                f"hold allows no method of order {self.order}: the condition of tree {tree} "
                "depends on nothing else, and isn't satisfied"
            )
        flat = len(rooted_trees_through(self.order))  # conditions where flows commute
        conditions = flat if system.rows is None else system.equations
        if not force and system.movable.size < conditions:
            raise ValueError(
                f"hold leaves {system.movable.size} unknowns for {conditions} conditions of order "
                f"{self.order}; pass force=True to try nevertheless"
            )

    @property
    def of_points(self) -> bool:
        """Whether they describe methods of points, not tableaux."""
        return self.tree is not None or self.flows is not None

    def check_tableau(self) -> None:
        """Raise TypeError or ValueError if an argument is only for methods of points."""
        for name in ("embedded", "first_same_as_last"):
            if check_flag(name, getattr(self, name)):
                raise ValueError(f"{name} needs flows; it is for commutator-free methods")

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
        return self.tree or draw_layout(
            self.stages,
            flows,
            random,
            embedded=self.embedded,
            first_same_as_last=self.first_same_as_last,
        )


def start_generator(seed: int, index: int) -> np.random.Generator:
    """Return the random generator of a start: one for each index, spawned from the seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))


def _check_counts(order: int, stages: int, flows: int, unknowns: int) -> None:
    if stages < MIN_STAGES[order - 1]:
        raise ValueError(
            f"stages = {stages} is too few for order {order}, which needs "
            f"{MIN_STAGES[order - 1]} even where flows commute; pass force=True to try "
            "nevertheless"
        )
    if (order, flows) == (4, 4):
        raise ValueError(
            "flows = 4 is too few for order 4, which needs 5: see the page 'Methods that do not "
            "exist' of the documentation; pass force=True to try nevertheless"
        )
    if unknowns < (conditions := len(rooted_trees_through(order))):
        raise ValueError(
            f"the flows have {unknowns} unknowns for {conditions} conditions of order {order} "
            "where flows commute; pass force=True to try nevertheless"
        )
