"""Find commutator-free methods like the catalogue's of orders five and six, from random starts.

Each recipe has the tree of points that a search over drawn trees (``cg.search(..., flows=n)``)
found to have methods. The conditions are solved from seeded random weights, and what is found
moves along the solution set to a small principal error. The best is written.

    python tools/make_commutator_free_methods.py FOLDER [NAME ...]
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg
from threadpoolctl import threadpool_limits

import cg
from cg.catalogue import save
from cg.certification import CertificationError, certify
from cg.conditions import count
from cg.construction import (
    Candidate,
    ConditionSystem,
    Goals,
    NotExactError,
    optimise,
    principal_error,
    solved,
    to_method,
)
from cg.layout import Layout
from cg.tree_shapes import layout_of

SEED = 1
GOALS = Goals(coefficients=2e-4, abscissae=0.2, bound_weight=0.03)
LARGEST = 6.0  # weights of what is worth moving along
CLEARLY = 3e-3  # least norm of the residuals of order q of a pair's second result


@dataclass(frozen=True)
class Recipe:
    """How to find a method.

    Attributes
    ----------
    name : str
    order : int
    tree : tuple
        Parents, the points of stages, and results if there are two.
    starts : int
        Random starts.
    certified : bool
        Whether only what has a certificate counts.
    """

    name: str
    order: int
    tree: tuple[tuple[int, ...] | int, ...]
    starts: int
    certified: bool = False


RECIPES = (
    Recipe(
        "CF4(3)",
        4,
        ((-1, 0, 1, 2, 3, 4, 1), (-1, 0, 1, 3, 4), 5, 6),
        60,
        certified=True,
    ),
    Recipe("CF5d", 5, ((-1, 0, 1, 2, 3, 4, 5, 6, 7), (-1, 0, 1, 2, 3, 4, 7)), 200),
    Recipe(
        "CF5a",
        5,
        ((-1, 0, 1, 2, 3, 4, 5, 5, 7), (-1, 0, 1, 2, 3, 6)),
        120,
        certified=True,
    ),
    Recipe(
        "CF5b",
        5,
        ((-1, 0, 1, 2, 3, 4, 0, 6, 7), (-1, 0, 1, 2, 3, 5)),
        120,
    ),
    Recipe(
        "CF5c",
        5,
        ((-1, 0, 1, 0, 3, 0, 5, 6), (-1, 0, 1, 2, 3, 4)),
        400,
    ),
    Recipe(
        "CF5(4)",
        5,
        ((-1, 0, 1, 2, 3, 4, 5, 6, 7, 7), (-1, 0, 1, 3, 4, 5, 7), 8, 9),
        120,
    ),
    Recipe(
        "CF6a",
        6,
        ((-1, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14), (-1, 0, 2, 4, 6, 11, 14)),
        400,
    ),
    Recipe(
        "CF6b",
        6,
        ((-1, 0, 1, 2, 3, 4, 5, -1, 7, 8, 9, 10, 11, 12, 13), (-1, 0, 1, 3, 6, 8, 13)),
        60,
    ),
    Recipe(
        "CF6c",
        6,
        ((-1, 0, -1, 2, 3, -1, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14), (-1, 0, 1, 2, 3, 4, 9, 12)),
        60,
    ),
)


def solutions(recipe: Recipe) -> list[tuple[int, Candidate]]:
    """Return where the starts that reach the solution set end, and their numbers."""
    layout = layout_of(recipe.tree)
    found = cg.search(recipe.order, layout.stages, recipe.starts, SEED, tree=recipe.tree)
    system = ConditionSystem(recipe.order, layout)
    candidates = [
        (start.index, Candidate(system, np.array(start.x, dtype=float)))
        for start in found.starts
        if start.exact
    ]
    return [(k, p) for k, p in candidates if p.largest <= LARGEST and solved(p)]


def second_residual(candidate: Candidate) -> float:
    """Return the norm of the residuals of order q of a pair's second result."""
    system, layout = candidate.system, candidate.system.layout
    second = Layout(layout.parents, layout.weights, layout.stage_points, layout.results[1:])
    values = ConditionSystem(system.order, second).residual(candidate.x, independent=False)
    return float(linalg.norm(values[count(system.order - 1) :]))


def merit(candidate: Candidate) -> float:
    """Return the principal error, more where weights or abscissae are large."""
    layout = candidate.system.layout
    sums = np.array([candidate.x[layout.row(k)].sum() for k in range(layout.stages)])
    outside = max(0.0, sums.max() - 1) + max(0.0, -sums.min())
    large = max(0.0, candidate.largest - 1.5)
    return float(principal_error(candidate) * (1 + large + 2 * outside))


def method(recipe: Recipe) -> cg.CommutatorFree:
    """Return the best method."""
    found = solutions(recipe)
    print(f"{recipe.name}: {len(found)} of {recipe.starts} starts", flush=True)
    moved = [(k, optimise(p, GOALS, max_iterations=80)) for k, p in found]
    if moved and moved[0][1].system.embedded:
        moved = [(k, p) for k, p in moved if second_residual(p) >= CLEARLY]
    for k, candidate in sorted(moved, key=lambda one: merit(one[1])):
        source = (
            f"random start {k} of seed {SEED} with a tree that was drawn at random, "
            "moved along the solution set to a small principal error"
        )
        if candidate.system.embedded:
            source = f"both results solved for jointly, {source}"
        try:
            best = to_method(candidate, name=recipe.name, source=source)
            if recipe.certified:
                certify(best)
        except (NotExactError, CertificationError):
            continue
        assert isinstance(best, cg.CommutatorFree)
        return best
    raise RuntimeError(f"{recipe.name}: no start led to a method")


def main(folder: str, *names: str) -> None:
    """Write the files and say what they hold."""
    known = {recipe.name: recipe for recipe in RECIPES}
    if unknown := set(names) - set(known):
        raise SystemExit(
            f"no recipe for {', '.join(sorted(unknown))}; there are {', '.join(known)}"
        )
    Path(folder).mkdir(parents=True, exist_ok=True)
    with threadpool_limits(1):
        for name in names or known:
            begun = time.process_time()
            found = method(known[name])
            save(found, Path(folder) / f"{name}.toml")
            largest = max(abs(float(entry.value)) for entry in found.coefficients)
            print(
                f"{name}: order {found.order}, {found.stages} stages, "
                f"{found.exponentials} exponentials, largest weight {largest:.4f}, "
                f"principal error {found.principal_error():.4g}; "
                f"{time.process_time() - begun:.0f} s of a core",
                flush=True,
            )


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    main(*sys.argv[1:])
