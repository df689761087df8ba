"""Find methods like the catalogue's explicit ones of orders three to six, from random starts.

Each recipe solves the order conditions from seeded random guesses and moves along the
solution set: to a small principal error, or by driving coefficients to exact zeros. The best
candidate with a certificate is written. CG5(4), CG5e, CG6f and CG6g of the catalogue are from here;
for the others, which came from such runs with other guesses, digits and errors differ a little.

    python research/make_explicit_methods.py FOLDER [NAME ...]
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from recipes import merit, run

from cg.construction.candidate import Candidate, NotExactError, refinable, solved, to_method
from cg.construction.drop import solve_start
from cg.construction.eliminate import eliminate
from cg.construction.methods.estimate import MAX_RATIO, estimate_ratio
from cg.construction.methods.tableau import Tableau
from cg.construction.optimise import Goals, fewer_exponentials, optimise
from cg.construction.proofs import CertificationError, certify
from cg.construction.search.start import random_start
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.construction.start import default_start, random_candidate
from cg.executors import as_finished
from cg.support.parallel import available_cores

SEED = 1
LARGEST = 4.0  # largest coefficient of candidates for optimisation
SINGLE = Goals(bound_weight=0.05)
STRUCTURED = Goals(coefficients=1e-4, abscissae=0.2, bound_weight=0.05)
PAIR = Goals(coefficients=0.02, abscissae=0.2)


@dataclass(frozen=True)
class Recipe:
    """How to find a method."""

    name: str
    system: ConditionSystem
    starts: int  # random guesses
    iterations: int  # steps from each; with a structure as in `cg.construct`
    aim: str = "error"  # "error", "flows" or "effort", flows times the q-th root of the error

    @property
    def source(self) -> str:
        """Where a method comes from, for its file."""
        kind = "moved along the solution set to a small principal error"
        if self.system.structure:
            kind = f"structure {self.system.structure.name}, stages dropped, {kind}"
        if self.system.embedded:
            kind = f"both weights solved for jointly, {kind}"
        if self.aim != "error":
            kind += ", then coefficients driven to exact zeros"
        return f"random start of seed {SEED}, {kind}"


RECIPES = (
    Recipe("CG3(2)", ConditionSystem.tableau(3, 3, embedded=True), 100, 200),
    Recipe("CG4b", ConditionSystem.tableau(4, 5), 1500, 60),
    Recipe("CG4c", ConditionSystem.tableau(4, 5), 1500, 60, "flows"),
    Recipe("CG4(3)", ConditionSystem.tableau(4, 6, embedded=True), 100, 200),
    Recipe("CG4(3)b", ConditionSystem.tableau(4, 5, embedded=True), 400, 200),
    Recipe("CG5b", ConditionSystem.tableau(5, 9), 2000, 250),
    Recipe("CG5c", ConditionSystem.tableau(5, 9), 2000, 250, "flows"),
    Recipe("CG5e", ConditionSystem.tableau(5, 9), 2000, 250, "effort"),
    Recipe("CG5d", ConditionSystem.tableau(5, 8), 3000, 400),
    Recipe("CG5(4)", ConditionSystem.tableau(5, 10, embedded=True), 500, 400),
    Recipe("CG6f", ConditionSystem.tableau(6, 13, structure=Structure.MIDDLE), 150, 0),
    Recipe("CG6g", ConditionSystem.tableau(6, 12, structure=Structure.MIDDLE), 150, 0),
)


def solutions(recipe: Recipe) -> list[Candidate]:
    """Return the candidates of the solution set that random starts reach, by their number."""
    system = recipe.system
    fixed = np.setdiff1d(np.arange(system.size), system.movable)

    def run(index: int) -> tuple[int, Candidate]:
        if system.structure:
            return index, _constructed(system, index)
        guess = random_start(SEED, index, system.size, 1.0)
        guess[fixed] = 0
        fit = fit_conditions(guess, system, max_iterations=recipe.iterations)
        return index, Candidate(system, fit.x)

    results = dict(as_finished(run, range(recipe.starts), available_cores()))
    candidates = [results[index] for index in range(recipe.starts)]
    return [p for p in candidates if p.largest <= LARGEST and solved(p)]


def _constructed(system: ConditionSystem, index: int) -> Candidate:
    """Return the result of a start with more stages than wanted, after dropping the others."""
    random = np.random.default_rng([SEED, index])
    start = default_start(system.order, system.structure)
    stages = max(system.stages, start.stages)
    wide = ConditionSystem.tableau(system.order, stages, structure=system.structure)
    guess = random_candidate(wide, start.width, random)
    candidate = solve_start(guess, start.iterations, promising=start.promising)
    if solved(candidate) and refinable(candidate):
        for smaller in eliminate(
            candidate, system.stages, random=random, restarts=1, accept=refinable
        ):
            candidate = smaller
    short = candidate.system.stages != system.stages
    return Candidate(system, np.full(system.size, np.inf)) if short else candidate


def candidates(recipe: Recipe) -> Iterator[Candidate]:
    """Yield optimised solutions, the best first."""
    candidates = solutions(recipe)
    print(f"{recipe.name}: {len(candidates)} of {recipe.starts} starts reach the solution set")
    if recipe.system.embedded:  # the tools along the set want all conditions independent
        candidates = [p for p in candidates if p.rank == len(p.system.conditions(True)[0])]
        moved = [optimise(p, PAIR, tolerance=1e-5) for p in candidates]
        moved = [p for p in moved if ratio(p) <= MAX_RATIO]
    else:
        goals = STRUCTURED if recipe.system.structure else SINGLE
        moved = [optimise(p, goals) for p in candidates]
    if recipe.aim != "error":
        thinned = [fewer_exponentials(p, largest=3.0) for p in moved]
        moved = [optimise(p, SINGLE, frozen=zeros) for p, zeros in thinned if solved(p)]
    yield from sorted(moved, key=KEYS[recipe.aim])


def ratio(candidate: Candidate) -> float:
    """Return the largest ratio of the error of a pair to its estimate."""
    layout = candidate.system.layout
    return estimate_ratio(Tableau.from_layout(layout, candidate.x.tolist())) or np.inf


def flows(candidate: Candidate) -> int:
    """Return how many coefficients aren't zero."""
    return int(np.count_nonzero(candidate.x))


KEYS: dict[str, Callable[[Candidate], Any]] = {
    "error": merit,
    "flows": lambda p: (flows(p), merit(p)),
    "effort": lambda p: flows(p) * merit(p) ** (1 / p.system.order),
}


def method(recipe: Recipe) -> Tableau:
    """Return the best candidate that is exact and has a certificate, at least in part."""
    for candidate in candidates(recipe):
        try:
            tableau = to_method(candidate, name=recipe.name, source=recipe.source)
            certify(tableau)
        except (NotExactError, CertificationError):
            continue
        return tableau
    raise RuntimeError(f"{recipe.name}: no start led to a method with a certificate")


if __name__ == "__main__":
    RECIPE = {recipe.name: recipe for recipe in RECIPES}
    run(lambda name: method(RECIPE[name]), RECIPE, __doc__)
