"""Find commutator-free methods like the catalogue's of orders four to seven, from random starts.

A recipe has the tree of points that a search over drawn trees (``cg.search(..., flows=n)``)
found to have methods, or the numbers of starts whose drawn trees do. The conditions are solved from
seeded random weights, points are left out until the wanted number of flows is left, and what is
found moves along the solution set to a small principal error. The best is written.

    python research/make_commutator_free_methods.py FOLDER [NAME ...]
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from recipes import merit, run

import cg
from cg.construction.attempt import run_attempt
from cg.construction.candidate import Candidate, NotExactError, solved, to_method
from cg.construction.drop import drop_flow, drop_point_stage
from cg.construction.optimise import Goals, optimise
from cg.construction.proofs import CertificationError, certify
from cg.construction.search.shapes import fixed_weights, layout_of
from cg.construction.search.start import start_layout
from cg.construction.settings import ConstructionSettings
from cg.construction.solvers.system import ConditionSystem, Structure

SEED = 1
GOALS = Goals(coefficients=2e-4, abscissae=0.2, bound_weight=0.03)
ITERATIONS = 150
LARGEST = 6.0  # largest weight of candidates for optimisation
NEGLIGIBLE = 1e-12  # smaller weights are set to zero
CLEARLY = 3e-3  # least norm of the residuals of order q of a pair's second result, over its weights
ESTIMATE = 10.0  # that norm over the principal error, where it can be chosen


@dataclass(frozen=True)
class Recipe:
    """How to find a method."""

    name: str
    order: int
    tree: tuple[tuple[int, ...] | int, ...] | None  # parents, points of stages, a pair's results
    starts: int | Sequence[int]  # how many random starts, or which
    certified: bool = True  # whether only what has a certificate counts
    flows: int | None = None  # how many are to be left; None for those of the tree
    stages: int = 0  # of trees that are drawn; else how many are to be left, or 0 for all
    first_flows: int | None = None  # of trees that are drawn
    pair: bool = False  # whether drawn trees have one more flow and stage for an estimate
    goals: Goals = GOALS
    seed: int = SEED  # of the starts


SEVEN = (
    (
        *(-1, -1, -1, 2, 3, -1, 5, 6, 6, 8, 9, 10, -1, 12),
        *(12, 14, 15, 0, 17, 18, 17, *range(20, 29)),
    ),
    (-1, 0, 1, 4, 7, 9, 11, 13, 16, 19, 20),
)
"""The tree of points that order seven starts from: 11 stages, 30 flows."""

RECIPES = (
    Recipe("CF4(3)", 4, ((-1, 0, 1, 2, 3, 4, 1), (-1, 0, 1, 3, 4), 5, 6), 60),
    Recipe("CF4c", 4, ((-1, 0, 1, 2, 3), (-1, 0, 1, 2, 3)), 60, certified=True),
    # of the family that it leads to, the catalogue has the rational method with c_3 = 3/5
    Recipe("CF4d", 4, ((-1, 0, 0, -1, 3), (-1, 0, 1, 2)), 60),
    Recipe("CF5e", 5, None, (25, 174), flows=10, stages=7, first_flows=10),
    Recipe("CF5d", 5, ((-1, 0, 1, 2, 3, 4, 5, 6, 7), (-1, 0, 1, 2, 3, 4, 7)), 200),
    Recipe("CF5a", 5, ((-1, 0, 1, 2, 3, 4, 5, 5, 7), (-1, 0, 1, 2, 3, 6)), 120),
    Recipe("CF5b", 5, ((-1, 0, 1, 2, 3, 4, 0, 6, 7), (-1, 0, 1, 2, 3, 5)), 120),
    Recipe("CF5c", 5, ((-1, 0, 1, 0, 3, 0, 5, 6), (-1, 0, 1, 2, 3, 4)), 400),
    Recipe("CF5(4)", 5, ((-1, 0, 1, 2, 3, 4, 5, 6, 7, 7), (-1, 0, 1, 3, 4, 5, 7), 8, 9), 120),
    Recipe(
        "CF6d",
        6,
        None,
        (98,),
        flows=13,
        stages=9,
        first_flows=18,
        goals=Goals(coefficients=1e-4, abscissae=1.0, bound_weight=0.03),
    ),
    Recipe(
        "CF6(5)", 6, None, (88,), flows=17, stages=8, first_flows=22, pair=True, certified=False
    ),
    Recipe("CF7a", 7, SEVEN, (13,), flows=26),
    Recipe("CF7b", 7, SEVEN, (12,), flows=25, stages=10, certified=False),
    Recipe("CF7c", 7, SEVEN, (13,), flows=28, stages=9),
    Recipe("CF6a", 6, None, 27, stages=7, first_flows=16, seed=101),
    Recipe(
        "CF6b", 6, ((-1, 0, 1, 2, 3, 4, 5, 6, 7, 8, -1, 10, 11, 12), (-1, 0, 1, 3, 4, 7, 9)), 400
    ),
    Recipe(
        "CF6c",
        6,
        ((-1, 0, -1, 2, 3, -1, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14), (-1, 0, 1, 2, 3, 4, 9, 12)),
        60,
    ),
)


def fewer(recipe: Recipe) -> list[tuple[int, Candidate]]:
    """Return the starts with a given tree, after dropping stages and flows, and their numbers."""
    assert recipe.tree is not None
    assert recipe.flows is not None
    all_flows = replace(recipe, flows=len(layout_of(recipe.tree).parents), stages=0)
    candidates = []
    for k, start in attempts(all_flows):
        random = np.random.default_rng(k)
        candidate: Candidate | None = start
        while candidate and candidate.system.stages > recipe.stages:
            candidate = drop_point_stage(candidate, random, largest=LARGEST)
        while candidate and len(candidate.system.layout.parents) > recipe.flows:
            candidate = drop_flow(candidate, random, largest=LARGEST)
        if candidate:
            candidates.append((k, candidate))
    return candidates


def attempts(recipe: Recipe) -> list[tuple[int, Candidate]]:
    """Return the starts that reach the wanted number of flows, and their numbers."""
    layout = None if recipe.tree is None else layout_of(recipe.tree)
    if layout is not None and 0 < recipe.stages < layout.stages:
        return fewer(recipe)
    settings = ConstructionSettings(
        order=recipe.order,
        stages=recipe.stages + recipe.pair if layout is None else layout.stages,
        seed=recipe.seed,
        structure=Structure.GENERAL,
        first_stages=recipe.stages,
        width=0.4,
        iterations=700 if recipe.order > 6 else 400,
        promising=1e-11,
        largest=LARGEST,
        restarts=2,
        full_rank=False,
        flows=recipe.flows,
        first_flows=recipe.first_flows if layout is None else len(layout.parents) - layout.pair,
        embedded=recipe.pair,
        tree=layout,
        first_same_as_last=recipe.pair,
    )
    starts = range(recipe.starts) if isinstance(recipe.starts, int) else recipe.starts
    tried = [run_attempt(settings, k) for k in starts]
    return [
        (one.index, Candidate(ConditionSystem(recipe.order, one.tree), np.array(one.x)))
        for one in tried
        if one.solved and one.flows == recipe.flows and one.tree is not None
    ]


def held_estimate(candidate: Candidate) -> list[int]:
    """Return the weight of an estimate that is held, since only their ratios count."""
    return [k for k in fixed_weights(candidate.system.order, candidate.system.layout) if k]


def scaled(candidate: Candidate) -> Candidate:
    """Return a pair whose estimate has a fitting size, where its last flow may have any."""
    layout = candidate.system.layout
    if not held_estimate(candidate):
        return candidate
    x = candidate.x.copy()
    # homogeneous conditions: the estimate is linear in these weights
    x[layout.starts[-2] :] *= ESTIMATE * candidate.principal_error / candidate.estimate
    return Candidate(candidate.system, x)


def solutions(recipe: Recipe) -> list[tuple[int, Candidate]]:
    """Return where the starts that reach the solution set end, and their numbers."""
    if recipe.flows is not None:
        return attempts(recipe)
    assert isinstance(recipe.starts, int)
    stages = recipe.stages if recipe.tree is None else layout_of(recipe.tree).stages
    drawn = {"flows": recipe.first_flows} if recipe.tree is None else {"tree": recipe.tree}
    results = cg.search(recipe.order, stages, recipe.starts, recipe.seed, **drawn)
    candidates = []
    for start in results.starts:
        if start.exact:
            system = ConditionSystem(recipe.order, start_layout(results.settings, start.index))
            x = np.array(start.x, dtype=float)
            x[np.abs(x) < NEGLIGIBLE] = 0
            candidates.append((start.index, Candidate(system, x)))
    return [(k, p) for k, p in candidates if p.largest <= LARGEST and solved(p)]


def along(candidate: Candidate, goals: Goals) -> Candidate:
    """Return the optimised candidate."""
    return optimise(
        candidate,
        goals,
        frozen=[*held_estimate(candidate), *np.flatnonzero(candidate.x == 0)],
        max_iterations=ITERATIONS,
        tolerance=1e-3,
    )


def method(recipe: Recipe) -> cg.CommutatorFree:
    """Return the best method."""
    candidates = solutions(recipe)
    print(f"{recipe.name}: {len(candidates)} of {recipe.starts} starts", flush=True)
    moved = [(k, scaled(along(p, recipe.goals))) for k, p in candidates]
    if moved and moved[0][1].system.embedded and not recipe.pair:
        moved = [(k, p) for k, p in moved if p.estimate >= CLEARLY]
    for k, candidate in sorted(moved, key=lambda one: merit(one[1])):
        source = (
            f"random start {k} of seed {recipe.seed} with a tree that was drawn at random, "
            "moved along the solution set to a small principal error"
        )
        if recipe.flows is not None:
            most = recipe.first_flows or len(layout_of(recipe.tree).parents)
            left = f"flows left out down to {recipe.flows}, " if most > recipe.flows else ""
            if recipe.tree is not None and recipe.stages:
                left = f"stages left out down to {recipe.stages}, {left}"
            source = (
                f"random start {k} of seed {recipe.seed} with a tree of {most} flows that was "
                f"drawn at random, {left}moved along the solution set to a small principal error"
            )
        if candidate.system.embedded:
            source = f"both results solved for jointly, {source}"
        try:
            best = without_idle_stages(to_method(candidate, name=recipe.name, source=source))
            if recipe.certified:
                certify(best, complete=True)
        except (NotExactError, CertificationError):
            continue
        return best
    raise RuntimeError(f"{recipe.name}: no start led to a method")


def without_idle_stages(method: cg.Method) -> cg.CommutatorFree:
    """Return the method without the stages that no flow is along."""
    stages = sorted({k for point in method.points for k in point.weights})
    texts = method.layout.point_weights([entry.text for entry in method.coefficients])
    return cg.CommutatorFree(
        [
            (point.parent, {stages.index(k): row[k] for k in point.weights})
            for point, row in zip(method.points, texts, strict=True)
        ],
        [method.stage_points[k] for k in stages],
        method.result,
        embedded_result=method.embedded_result,
        name=method.name,
        source=method.source,
    )


if __name__ == "__main__":
    RECIPE = {recipe.name: recipe for recipe in RECIPES}
    run(lambda name: method(RECIPE[name]), RECIPE, __doc__)
