"""Construction of exact methods with few stages or flows from random starts."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any

from cg.construction.attempt import Attempt, refined, run_attempt, succeeded
from cg.construction.methods.method import Method
from cg.construction.runs.long_run import RunOptions, Score, run_pieces
from cg.construction.search.requirements import Requirements
from cg.construction.search.settings import Settings
from cg.construction.solvers.system import Structure
from cg.support import quads
from cg.support.checks import MAX_COUNT, check_integer
from cg.support.executors import ExecutorLike
from cg.support.parallel import single_threads


@dataclass(frozen=True)
class Construction:
    """The result of a construction."""

    settings: Settings
    method: Method | None  # refined in real(16); None if no try succeeded
    best: Attempt  # the try of the method, or the one with the fewest stages and flows
    tries: int

    @property
    def exact(self) -> bool:
        """Whether a method was found."""
        return self.method is not None


@single_threads()
def construct(
    order: int,
    stages: int,
    seed: int = 0,
    *,
    tries: int = 400,
    largest: float = 3.0,
    restarts: int = 1,
    full_rank: bool = False,
    structure: Structure | None = None,
    first_stages: int | None = None,
    width: float | None = None,
    iterations: int | None = None,
    workers: int | None = None,
    executor: ExecutorLike = None,
    store: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | bool | None = None,
    force: bool = False,
    tree: Any = None,
    flows: int | None = None,
    first_flows: int | None = None,
    embedded: bool = False,
    first_same_as_last: bool = False,
    abscissae: Sequence[float] | None = None,
    minimise: str | None = None,
    hold: Mapping[str, Any] | None = None,
) -> Construction:
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
    largest
        Bound on the magnitude of coefficients.
    restarts
        Largest number of walks along the solution set after elimination fails.
    full_rank
        Accept only candidates at which all conditions are independent, as a certificate without
        further identities requires.
    structure
        Simplifying assumptions. By default `Structure.MIDDLE` from order 6 on, and for fewer
        stages than a general method needs; none with `full_rank`.
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
        set with coefficients below `largest`. With `hold`, no stages or flows are eliminated.

    Examples
    --------
    >>> construct(order=3, stages=3).method.order
    3
    """
    settings = Settings.checked(
        "construct", force, order, stages, seed, hold=hold, largest=largest, restarts=restarts,
        full_rank=full_rank, structure=structure, first_stages=first_stages, width=width,
        iterations=iterations, tree=tree, flows=flows, first_flows=first_flows,
        embedded=embedded, first_same_as_last=first_same_as_last,
    )  # fmt: skip
    quads.core("cg.construct")
    tries = check_integer("tries", tries, 1, MAX_COUNT)
    options = RunOptions.checked(workers, executor, store, progress)
    bound = None if abscissae is None and minimise is None else settings.largest
    requirements = Requirements.checked(order, abscissae, bound, minimise)
    results = run_pieces(
        settings, partial(run_attempt, settings), tries, options,
        read=Attempt.of_fields,
        score=lambda attempt: Score(attempt.f, succeeded(settings, attempt)),
    )  # fmt: skip
    # the first one by number counts
    finished: dict[int, Attempt] = {}
    with closing(results):
        for index in range(tries):
            while index not in finished:
                attempt = next(results)
                finished[attempt.index] = attempt
            reached = succeeded(settings, finished[index])
            method = refined(settings, finished[index], requirements) if reached else None
            if method is not None:
                return Construction(settings, method, finished[index], index + 1)
    best = min(
        finished.values(), key=lambda a: (not a.solved, a.stages, a.flows or 0, a.f, a.index)
    )
    return Construction(settings, None, best, tries)
