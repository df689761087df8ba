"""Construction of exact methods: random starts, from which stages or flows are eliminated."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Self

import numpy as np

from cg.construction.layouts import Layout
from cg.construction.methods.method import Method
from cg.construction.runs import run_pieces
from cg.construction.search.candidate import Candidate, Reduction, default_name, solve_start
from cg.construction.search.requirements import Requirements
from cg.construction.search.settings import Settings
from cg.construction.search.shapes import (
    draw_guess,
    fixed_entries,
    layout_of_fields,
    start_generator,
)
from cg.construction.solvers.system import Structure
from cg.support import flint, quads
from cg.support.checks import MAX_COUNT, check_integer
from cg.support.parallel import ExecutorLike, single_threads


@dataclass(frozen=True)
class Try:
    """The result of one try, which its number `index` and the settings determine."""

    index: int
    solved: bool  # whether x is on the solution set and within bounds
    f: float  # sum of squared residuals in double
    x: tuple[float, ...] = field(repr=False)
    layout: Layout = field(repr=False)  # the smallest one reached

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any]) -> Self:
        """Return the try whose fields `dataclasses.asdict` has returned."""
        layout = layout_of_fields(fields["layout"])
        return cls(**{**fields, "x": tuple(fields["x"]), "layout": layout})


def run_try(settings: Settings, index: int) -> Try:
    """Run one try: solve from a random guess, then eliminate stages or flows."""
    random = start_generator(settings.seed, index)
    if settings.first_flows is not None:
        layout = settings.tree_for(settings.first_flows, random)
    else:
        spread = max(0, settings.first_stages - settings.stages)
        stages = settings.first_stages + (int(random.integers(0, 4)) if spread else 0)
        layout = Layout.tableau(stages, pair=settings.embedded)
    system = settings.system(layout)
    guess = draw_guess(layout, settings.width, random, fixed_entries(settings.order, layout))
    guess[system.zeros] = 0.0
    start = Candidate(system, guess)
    candidate = solve_start(start, settings.iterations, promising=settings.promising)
    reduction = Reduction(random, settings.max_coefficient, settings.restarts)
    goal = ("stages", settings.stages) if settings.flows is None else ("flows", settings.flows)
    if reduction.accepts(candidate):
        candidate = reduction.eliminate(candidate, *goal)
    solved, x = reduction.accepts(candidate), tuple(candidate.x.tolist())
    return Try(index, solved, candidate.f, x, candidate.system.layout)


def succeeded(settings: Settings, result: Try) -> bool:
    """Return whether a try reached a solution with the stages and flows of the settings."""
    layout = result.layout
    is_small = layout.stages == settings.stages and settings.flows in (None, layout.flows)
    return result.solved and is_small


def refined(settings: Settings, result: Try, requirements: Requirements) -> Method | None:
    """Return the method of a try, refined in real(16); None if it isn't exact or as required."""
    system = settings.system(result.layout)
    return requirements.method(
        Candidate(system, np.array(result.x, dtype=np.float64)),
        name=default_name(system, settings.seed, f"try{result.index}"),
        source=f"construct, seed {settings.seed}, try {result.index}",
    )


@dataclass(frozen=True)
class Construction:
    """The result of a construction."""

    settings: Settings
    method: Method | None  # refined in real(16); None if no try succeeded
    best: Try  # the try of the method, or the one with the fewest stages and flows
    tries: int

    @property
    def exact(self) -> bool:
        """Whether a method was found."""
        return self.method is not None

    def __repr__(self) -> str:
        settings, outcome = self.settings, repr(self.method)
        if self.method is None:
            outcome = f"no method in {self.tries} tries, the smallest f {self.best.f:.2g}"
        return (
            f"<Construction: order {settings.order}, {settings.stages} stages, seed "
            f"{settings.seed}: {outcome}>"
        )


@single_threads()
def construct(
    order: int, stages: int, seed: int = 0, *, tries: int = 400, max_coefficient: float = 3.0,
    restarts: int = 1, structure: Structure | None = None, first_stages: int | None = None,
    width: float | None = None, iterations: int | None = None, workers: int | None = None,
    executor: ExecutorLike = None, store: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | bool | None = None, force: bool = False,
    tree: Any = None, flows: int | None = None, first_flows: int | None = None,
    embedded: bool = False, first_same_as_last: bool = False,
    abscissae: Sequence[float] | None = None, minimise: str | None = None,
    hold: Mapping[str, Any] | None = None,
) -> Construction:  # fmt: skip
    """Construct an exact explicit method from random starts.

    Each try solves the order conditions from a random guess with enough stages, then eliminates
    stages along the solution set. With `flows`, it starts from a random tree of points with enough
    flows and eliminates flows. The method of the first successful try by number is returned,
    whatever the number of workers.

    Parameters
    ----------
    order, stages
        Order and number of stages of the method.
    seed
        Seed of all tries, not negative; on one machine try k depends on (seed, k) alone.
    tries
        Largest number of random starts.
    max_coefficient
        Bound on the magnitude of coefficients.
    restarts
        Largest number of walks along the solution set after elimination fails.
    structure
        Simplifying assumptions. By default `Structure.MIDDLE` from order 6 on, and for fewer
        stages than a general method needs.
    first_stages
        Number of stages of random starts; the default depends on order and structure.
    iterations
        Largest number of steps of the solver in each run; the default depends on order and
        structure.
    width, workers, executor, store, progress, force, tree
        As for `cg.search`. The bar shows the remaining time of all tries, of which most may not be
        needed.
    flows
        Construct a `cg.CommutatorFree` method with this number of flows, from a random tree, or
        from `tree` by dropping points. The flow to a second result doesn't count.
    first_flows
        Number of flows of the random trees to start from; by default `flows`.
    embedded, first_same_as_last, abscissae, minimise, hold
        As for `cg.search`. With `abscissae` or `minimise`, the method is moved along its solution
        set with coefficients below `max_coefficient`. With `hold`, no stages or flows are
        eliminated.

    Examples
    --------
    >>> construct(order=3, stages=3).method.order
    3
    """
    settings = Settings.checked(
        "construct", force, order, stages, seed, hold=hold,
        max_coefficient=max_coefficient, restarts=restarts,
        structure=structure, first_stages=first_stages, width=width,
        iterations=iterations, tree=tree, flows=flows, first_flows=first_flows,
        embedded=embedded, first_same_as_last=first_same_as_last,
    )  # fmt: skip
    quads.core("cg.construct")
    _ = flint.ctx  # an error if it is missing, by which results are refined
    tries = check_integer("tries", tries, 1, MAX_COUNT)
    bound = None if abscissae is None and minimise is None else settings.max_coefficient
    requirements = Requirements.checked(order, abscissae, bound, minimise)
    results = run_pieces(
        settings, partial(run_try, settings), tries,
        read=Try.of_fields, solved=partial(succeeded, settings),
        workers=workers, executor=executor, store=store, progress=progress,
    )  # fmt: skip
    # the first success by number counts
    finished: dict[int, Try] = {}
    with closing(results):
        for index in range(tries):
            while index not in finished:
                result = next(results)
                finished[result.index] = result
            reached = succeeded(settings, finished[index])
            method = refined(settings, finished[index], requirements) if reached else None
            if method is not None:
                return Construction(settings, method, finished[index], index + 1)
    best = min(
        finished.values(),
        key=lambda each: (not each.solved, each.layout.stages, each.layout.flows, each.f),
    )
    return Construction(settings, None, best, tries)
