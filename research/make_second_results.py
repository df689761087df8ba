"""Give pairs second results with flows of their own, which see commutators.

The difference of two results that share flows doesn't see the errors that these leave (see
`methods/estimate.py`). Here the second result starts from the initial point, and its weights add up
to the row b̂ that the pair has. Of the results of all starts for which the ratio of error to
estimate is at most 2, or of all if there is none, the one with the least principal error is taken.

    python research/make_second_results.py FOLDER [NAME ...]
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recipes import run

import cg
from cg.construction.conditions import condition_trees, core_calls
from cg.construction.layouts.layout import Layout
from cg.construction.layouts.points import START
from cg.construction.lifting.exact import refined
from cg.construction.lifting.solver import fit
from cg.construction.lifting.split_rows import FlatRows, SplitRows, path_sums
from cg.construction.methods.estimate import estimate_ratio
from cg.construction.solvers.held import Held

_WIDTH = 0.6
_ITERATIONS = 100
_SEED = 1
_MAX_RATIO = 2.0
_ROUNDING = 1e-30  # of sums of weights that are zero


@dataclass(frozen=True)
class Recipe:
    """How the second result of a pair is found: by how many flows and starts.

    If ``distance`` isn't None, b̂ - b is scaled to it: the largest entry. Otherwise estimates may be
    far larger than errors.
    """

    flows: int
    tries: int
    distance: Fraction | None = None


RECIPES = {
    "BS3(2)": Recipe(1, 1),
    "CF5(4)": Recipe(2, 200, Fraction("0.09")),
    "CF6(5)": Recipe(4, 100, Fraction("0.12")),
    "CF7(6)": Recipe(5, 60),
    "DOP853": Recipe(4, 60),
    "DP5(4)": Recipe(2, 150),
    "DVERK6(5)": Recipe(4, 100),
    "Verner7(6)": Recipe(5, 60),
    "Verner8(7)": Recipe(8, 40),
}
NOTE = "; the second result by flows of its own"


@dataclass(frozen=True)
class SecondResult(SplitRows):
    """The conditions on a second result, where the first one and the stages are held."""

    held: tuple[Fraction, ...] = ()

    @cached_property
    def sums(self) -> Held:
        """The sums of rows, and weights that are held."""
        held = [(frozenset({k}), value) for k, value in enumerate(self.held)]
        return Held.solving([*path_sums(self.rows, self.layout), *held], self.layout.size)

    def second_error(self, x: NDArray[np.float64]) -> float:
        """Return the principal error of the second result."""
        order = self.embedded_order + 1
        trees = np.array(condition_trees(order)[len(condition_trees(order - 1)) :], dtype=np.intc)
        owner = np.full(len(trees), -1, dtype=np.intc)
        residuals = core_calls.residuals(order, self.layout, x, trees, owner)
        return float(np.linalg.norm(residuals))


def split_of(method: cg.CommutatorFree, recipe: Recipe) -> SecondResult:
    """Return the split rows of the flat second weights, to be solved."""
    tree = method.tree
    count = 1 + max(*tree.stage_points, tree.result)
    assert method.embedded_result is not None
    assert method.embedded_order is not None
    second = tree.flat_row(method.embedded_result)
    if recipe.distance is not None:
        b = method.exact[1]
        scale = recipe.distance / max(abs(y - x) for x, y in zip(b, second, strict=True))
        second = tuple(x + scale * (y - x) for x, y in zip(b, second, strict=True))
    second = tuple(x if abs(x) > _ROUNDING else Fraction(0) for x in second)
    used = tuple(k for k in range(method.stages) if second[k])
    chain = [START, *range(count, count + recipe.flows - 1)]
    layout = Layout(
        (*(point.parent for point in tree.points[:count]), *chain),
        (*(tuple(point.weights) for point in tree.points[:count]), *[used] * recipe.flows),
        tree.stage_points,
        (method.result, count + recipe.flows - 1),
    )
    held = tuple(w for point in tree.points[:count] for w in point.weights.values())
    rows = FlatRows(*method.exact, second)
    return SecondResult(rows, layout, method.order, method.embedded_order, held=held)


def make(method: cg.CommutatorFree, recipe: Recipe) -> tuple[cg.CommutatorFree, int]:
    """Return the pair, and how many starts led to one."""
    split = split_of(method, recipe)
    results = []
    for index in range(recipe.tries):
        generator = np.random.default_rng(np.random.SeedSequence(_SEED, spawn_key=(index,)))
        start = generator.uniform(-_WIDTH, _WIDTH, split.movable.size)
        end = fit(split, split.from_unknowns(start), max_iterations=_ITERATIONS)
        if end.solved:
            ratio = estimate_ratio(pair_of(method, split, end.x.tolist())) or np.inf
            results.append((max(ratio, _MAX_RATIO), split.second_error(end.x), index, end.x))
    weights = list(refined(split, min(results)[-1]).weights)
    first = [w.text for row in method.point_coefficients for w in row.values()]
    held = len(split.held)
    return pair_of(method, split, [*first[:held], *weights[held:]]), len(results)


def pair_of(
    method: cg.CommutatorFree, split: SplitRows, weights: Sequence[Any]
) -> cg.CommutatorFree:
    """Return the pair with given weights."""
    return cg.CommutatorFree.from_layout(
        split.layout, weights, third=method.third_weights, name=method.name,
        source=method.source.removesuffix(NOTE) + NOTE,
    )  # fmt: skip


def lifted(name: str) -> cg.CommutatorFree:
    """Return a lifted pair of the catalogue with a new second result."""
    method = cg.methods[name]
    assert isinstance(method, cg.CommutatorFree)
    pair, hits = make(method, RECIPES[name])
    print(f"{name}: {hits} of {RECIPES[name].tries} starts, ratio {estimate_ratio(pair):.3g}")
    return pair


if __name__ == "__main__":
    run(lifted, RECIPES, __doc__)
