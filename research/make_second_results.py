"""Give lifted pairs second results with separate flows, which sense the error of splitting rows.

The difference of both results by one frozen combination, Σ (b̂ - b) F, is the estimate of the flat
pair, whatever the splitting. Here the second result starts from a point on the way to the first
one, and its weights add up to b̂. Of all starts that lead to one, the least principal error counts.

    python research/make_second_results.py FOLDER [NAME ...]
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recipes import run

import cg
from cg.conditions import compiled as compiled_conditions
from cg.conditions import condition_trees
from cg.construction.lifting.exact import refined
from cg.construction.lifting.solver import fit
from cg.construction.lifting.splitting import (
    FlatRows,
    Remainders,
    Splitting,
    path_sums,
    solve_sums,
)
from cg.structure.layout import Layout
from cg.structure.points import START

_WIDTH = 0.6
_ITERATIONS = 100
_SEED = 1


@dataclass(frozen=True)
class Recipe:
    """How the second result of a pair is found: from which point, by how many flows and starts."""

    parent: int
    flows: int
    tries: int


RECIPES = {
    "BS3(2)": Recipe(START, 1, 1),
    "DP5(4)": Recipe(START, 2, 150),
    "DVERK6(5)": Recipe(START, 4, 100),
    "Verner7(6)": Recipe(26, 4, 20),
    "Verner8(7)": Recipe(45, 7, 2),
}
NOTE = "; the second result by flows of its own"


@dataclass(frozen=True)
class SecondResult(Splitting):
    """The conditions on a second result, where the first one and the stages are held."""

    held: tuple[Fraction, ...] = ()

    @cached_property
    def remainders(self) -> Remainders:
        """Held and dependent weights in terms of the unknowns."""
        held = [(frozenset({k}), value) for k, value in enumerate(self.held)]
        return solve_sums([*path_sums(self.rows, self.layout), *held], self.layout.size)

    def second_error(self, x: NDArray[np.float64]) -> float:
        """Return the principal error of the second result."""
        order = self.embedded_order + 1
        trees = np.array(condition_trees(order)[len(condition_trees(order - 1)) :], dtype=np.intc)
        owner = np.full(len(trees), -1, dtype=np.intc)
        residuals = compiled_conditions.residuals(order, self.layout, x, trees, owner)
        return float(np.linalg.norm(residuals))


def flat_estimate(pair: cg.CommutatorFree) -> cg.CommutatorFree:
    """Return a pair with its flat estimate: the second result is one flow from the first."""
    assert pair.exact_embedded is not None
    count = pair.result + 1
    rows = zip(pair.points[:count], pair.point_coefficients, strict=False)
    points: list[tuple[int, Mapping[int, Any]]] = [(point.parent, row) for point, row in rows]
    weights = zip(pair.exact_embedded, pair.exact[1], strict=True)
    points.append((pair.result, {k: second - b for k, (second, b) in enumerate(weights)}))
    return cg.CommutatorFree(
        points, pair.stage_points, pair.result, embedded_result=count, name=pair.name
    )


def splitting_of(method: cg.CommutatorFree, recipe: Recipe) -> SecondResult:
    """Return the splitting of the flat second weights, to be solved."""
    tree, count = method.tree, method.result + 1
    assert method.embedded_result is not None
    assert method.embedded_order is not None
    second = tree.flat_row(method.embedded_result)
    begun = tree.flat_row(recipe.parent)
    used = tuple(k for k in range(method.stages) if second[k] or begun[k])
    chain = [recipe.parent, *range(count, count + recipe.flows - 1)]
    layout = Layout(
        (*(point.parent for point in tree.points[:count]), *chain),
        (*(tuple(point.weights) for point in tree.points[:count]), *[used] * recipe.flows),
        tree.stage_points,
        (method.result, count + recipe.flows - 1),
    )
    held = tuple(w for point in tree.points[:count] for w in point.weights.values())
    rows = FlatRows(*method.exact, second)
    return SecondResult(rows, layout, method.order, method.embedded_order, held=held)


def make(method: cg.CommutatorFree, recipe: Recipe) -> tuple[cg.CommutatorFree, float, int]:
    """Return the pair, the principal error of its second result, and how many starts led to one."""
    splitting = splitting_of(method, recipe)
    results = []
    for index in range(recipe.tries):
        generator = np.random.default_rng(np.random.SeedSequence(_SEED, spawn_key=(index,)))
        start = generator.uniform(-_WIDTH, _WIDTH, splitting.free.size)
        end = fit(splitting, splitting.from_unknowns(start), max_iterations=_ITERATIONS)
        if end.solved:
            results.append((splitting.second_error(end.x), index, end.x))
    error, _, x = min(results)
    weights = list(refined(splitting, x).weights)
    first = [w.text for row in method.point_coefficients[: method.result + 1] for w in row.values()]
    weights[: len(first)] = first
    source = method.source.removesuffix(NOTE) + NOTE
    layout = splitting.layout
    pair = cg.CommutatorFree.from_layout(layout, weights, name=method.name, source=source)
    return pair, error, len(results)


def lifted(name: str) -> cg.CommutatorFree:
    """Return a lifted pair of the catalogue with a new second result."""
    method = cg.methods[name]
    assert isinstance(method, cg.CommutatorFree)
    pair, error, hits = make(method, RECIPES[name])
    print(f"{name}: {hits} of {RECIPES[name].tries} starts, second result's error {error:.1e}")
    return pair


if __name__ == "__main__":
    run(lifted, RECIPES, __doc__)
