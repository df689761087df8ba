"""Trees of points for a search: given by their parents and stages, or drawn at random."""

from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.layouts import Layout, Rows
from cg.construction.methods.commutator_free import as_index
from cg.construction.points import START, MethodError, PointTree, check_tree

_FIXED_FIRST = (0.2, 0.8)  # range of the first weight, fixed while solving
_FIXED_LAST = (0.1, 0.2)  # range of the last weight of an estimate, fixed while solving
_FIXED_FROM = 5  # lowest order for which the first weight is fixed
_BACK = 0.3  # probability that a flow starts from a random earlier point, not the last one
_FREE_DRAWS = 10_000  # draws of a tree; then flows start from earlier points behind stages alone


def layout_of(tree: Any) -> Layout:
    """Return the layout of a tree of points, as `cg.search` takes it."""
    if isinstance(tree, Layout):
        layout = tree
    elif isinstance(getattr(tree, "tree", None), PointTree):
        check_tree(tree.tree)
        return Layout.of_tree(tree.tree)
    else:
        layout = _layout_of_lists(tree)
    if layout.rows is not None:
        raise MethodError("tree must be one of points, got the layout of a tableau")
    check_tree(layout.tree([1] * layout.size))  # type: ignore[list-item]
    return layout


def _layout_of_lists(tree: Any) -> Layout:
    expected = "a PointTree, or its parents, the points of stages and optional results"
    if isinstance(tree, str | bytes) or not isinstance(tree, Sequence):
        raise TypeError(f"tree must be {expected}, got {tree!r}")
    if not 2 <= len(tree) <= 4:
        raise TypeError(f"tree must be {expected}, got {len(tree)} entries")
    parents, stage_points = _indices("parents", tree[0]), _indices("stage_points", tree[1])
    results = tuple(as_index(end) for end in tree[2:]) or (len(parents) - 1,)
    return _with_all_weights(parents, stage_points, results)


def _with_all_weights(
    parents: Sequence[int], stage_points: Sequence[int], results: Sequence[int]
) -> Layout:
    """Return the layout in which each flow has weights on all stages before it."""
    weights = tuple(
        tuple(stage for stage, at in enumerate(stage_points) if isinstance(at, int) and at < m)
        for m in range(len(parents))
    )
    return Layout(tuple(parents), weights, tuple(stage_points), tuple(results))


def _indices(label: str, values: Any) -> tuple[Any, ...]:
    if isinstance(values, str | bytes) or not isinstance(values, Sequence | np.ndarray):
        raise TypeError(f"{label} of tree must be a sequence of integers, got {values!r}")
    return tuple(map(as_index, values))


def draw_layout(
    stages: int, flows: int, random: np.random.Generator, *, embedded: bool = False,
    first_same_as_last: bool = False,
) -> Layout:  # fmt: skip
    """Draw a random tree of points, in which every point leads to a stage or the result.

    Each flow has weights on all stages before it. `flows` is at least `stages`: all stages but the
    first have points of their own, and the result is one more.
    """
    inner, ends = flows - 1, stages - first_same_as_last
    for draw in count():
        drawn = [0, *(1 + random.permutation(max(0, inner - 1))[: max(0, ends - 2)])]
        at = sorted(int(m) for m in drawn[: ends - 1])
        back = random.random(flows) < _BACK
        if draw >= _FREE_DRAWS:
            back[1:] &= np.isin(np.arange(inner), at)
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
    """Return the layout whose fields `dataclasses.asdict` has returned."""
    return Layout(
        tuple(fields["parents"]),
        tuple(map(tuple, fields["weights"])),
        tuple(fields["stage_points"]),
        tuple(fields["results"]),
        None if fields["rows"] is None else Rows(fields["rows"]),
    )


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
    number = {START: START} | {m: k for k, m in enumerate(points)}
    rows = [dict(sorted(weights[m].items())) for m in points]
    smaller = Layout(
        tuple(number[parents[m]] for m in points),
        tuple(map(tuple, rows)),
        tuple(number[m] for m in layout.stage_points),
        tuple(number[m] for m in layout.results),
    )
    return smaller, np.array([weight for row in rows for weight in row.values()])


def fixed_entries(order: int, layout: Layout) -> list[int]:
    """Return the indices of the entries to hold fixed while solving from a random start.

    From order 5 on, the first weight of a tree, or a_21 of an explicit tableau, keeps the solver
    away from degenerate limits where it tends to zero. With c_2 = ε, c_3 ~ ε^(1/2), c_4 ~ ε^(1/4)
    and so on, C(2) holds at all stages as ε tends to zero: f falls below 1e-18 there, but has no
    zero. The conditions on a last flow to a second result are homogeneous in its weights, so that
    one of them is fixed to determine its length.
    """
    explicit = layout.rows in (None, Rows.EXPLICIT) and layout.stages > 1
    fixed = [0] if order >= _FIXED_FROM and explicit else []
    last = len(layout.parents) - 1
    at_end = layout.pair and layout.results[1] == last
    if layout.rows is None and at_end and layout.parents[last] == layout.results[0]:
        fixed.append(layout.size - 1)
    return fixed


def draw_guess(
    layout: Layout, width: float, random: np.random.Generator, fixed: Sequence[int]
) -> NDArray[np.float64]:
    """Return random coefficients, uniform in [-width, width] except for those to hold fixed."""
    guess = random.uniform(-width, width, layout.size)
    guess[layout.fixed] = 0.0
    for k in fixed:
        guess[k] = random.uniform(*(_FIXED_LAST if k else _FIXED_FIRST))
    return guess


def max_unknowns(stages: int, flows: int) -> int:
    """Return the largest number of weights of a drawn tree, without those to a second result."""
    return sum(min(m + 1, stages) for m in range(flows))


def start_generator(seed: int, index: int) -> np.random.Generator:
    """Return the random generator of a start: one for each index, spawned from the seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
