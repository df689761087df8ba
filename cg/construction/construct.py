"""From random starts to an exact method with few stages."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from ..method.method import Method
from ..runs import (
    ExecutorLike,
    Failure,
    Finished,
    ProgressLine,
    StoredRun,
    Tally,
    check_executor,
    check_progress,
    completed,
    stored_run,
)
from ..support import quads
from ..support.checks import MAX_COUNT, check_flag, check_integer
from ..support.parallel import single_threads
from .attempt import Attempt, arrived, check_attempt, refined, run_attempt
from .settings import ConstructionSettings, tableau_settings, tree_settings
from .solvers.system import Structure

__all__ = ["Construction", "construct"]


@dataclass(frozen=True)
class Construction:
    """What a construction came to.

    Attributes
    ----------
    settings : ConstructionSettings
    method : Method or None
        The exact method, refined in real(16); None if the tries ran out.
    best : Attempt
        The attempt that the method is from, else the one that came furthest: not a
        method of the wanted order and stages.
    tries : int
        Attempts made.
    failures : tuple of Failure
        Tries whose worker died.
    """

    settings: ConstructionSettings
    method: Method | None
    best: Attempt
    tries: int
    failures: tuple[Failure, ...] = ()

    @property
    def exact(self) -> bool:
        """Whether a method was found."""
        return self.method is not None


@single_threads()
def construct(
    order: int,
    stages: int,
    seed: int,
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
    progress: Callable[[Attempt], None] | ProgressLine | bool | None = None,
    force: bool = False,
    tree: Any = None,
    flows: int | None = None,
    first_flows: int | None = None,
    embedded: bool = False,
    first_same_as_last: bool = False,
) -> Construction:
    """Construct an exact explicit method from random starts.

    Each try solves the order conditions from a random guess with enough stages and then
    eliminates stages along the solution set; with `flows`, from a random tree of points with
    enough flows, of which it eliminates flows. The method returned is the one of the
    first successful try by number, whatever the number of workers.

    Parameters
    ----------
    order, stages : int
        What is wanted.
    seed : int
        Not negative; on one machine try k depends on (seed, k) alone.
    tries : int, optional
        Random starts at most.
    largest : float, optional
        Bound on the magnitude of coefficients.
    restarts : int, optional
        Walks along the solution set where elimination gets stuck.
    full_rank : bool, optional
        Accept only candidates at which all conditions are independent, which is what a
        certificate without further identities needs.
    structure : Structure, optional
        Simplifying assumptions to look for methods with. By default those of
        `Structure.MIDDLE` from order 6 on, and for fewer stages than the conditions of
        a general method need; none with `full_rank`.
    first_stages : int, optional
        Stages of the random starts; by default what order and structure make easy.
    width : float, optional
        Guesses are uniform in [-width, width]; by default what order and structure ask for.
    iterations : int, optional
        Bound on the solver's steps for a random start, and once more where they lead far
        down; by default what order and structure ask for.
    workers : int, optional
        Number of workers; by default all cores, or as many as `executor` has.
    executor : Executor, callable or str, optional
        Where tries run, as `cg.search` takes it.
    store : path, optional
        File that receives every try, and from which an interrupted run goes on, as `cg.search`
        takes it.
    progress : callable, ProgressLine or bool, optional
        Called with each `Attempt`. True tells on standard error how far it is:
        `cg.runs.ProgressLine`. The time that is left is that of all tries, of which most may not
        be needed.
    force : bool, optional
        Try even where there are fewer unknowns than independent conditions; for trees, than
        conditions where flows commute.
    tree : PointTree, method, or sequence, optional
        Look for a method with this tree of points, as `cg.search` takes it.
    flows : int, optional
        Look for a method of points, `cg.CommutatorFree`, with so many flows. Its tree is drawn,
        or points of the given one are left out until so many remain. The flow to a second
        result doesn't count.
    first_flows : int, optional
        Flows of the trees that are drawn, by default `flows`. Points are left out from there.
    embedded : bool, optional
        With `flows`, whether one more flow, from the result, leads to a second result of order
        one less.
    first_same_as_last : bool, optional
        With `flows`, whether the last stage is at the result, where the next step begins.

    Returns
    -------
    Construction

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range, or there are too few stages.
    MissingQuadsError
        If the package was built without quadruple precision.

    Examples
    --------
    >>> construct(order=3, stages=3, seed=1).method.order
    3
    """
    common = (order, stages, seed, largest, restarts, full_rank, structure, first_stages)
    of_points = tree is not None or flows is not None or first_flows is not None
    if of_points:
        settings = tree_settings(
            *common,
            width,
            iterations,
            force,
            tree,
            flows,
            first_flows,
            embedded,
            first_same_as_last,
        )
    elif check_flag("embedded", embedded):
        raise ValueError("embedded needs a number of flows, got a construction of tableaux")
    elif check_flag("first_same_as_last", first_same_as_last):
        raise ValueError("first_same_as_last needs a number of flows, got one of tableaux")
    else:
        settings = tableau_settings(*common, width, iterations, force)
    quads.core("cg.construct")
    tries = check_integer("tries", tries, 1, MAX_COUNT)
    call, line = check_progress(progress)
    executor, workers = check_executor(executor, workers)
    told = partial(_Told, settings, call, Tally(line, "tries", tries))
    if store is None:
        return _construct(settings, tries, workers, executor, told(None))
    with stored_run(store, "construct", asdict(settings)) as kept:
        return _construct(settings, tries, workers, executor, told(kept))


def _construct(
    settings: ConstructionSettings,
    tries: int,
    workers: int | None,
    executor: ExecutorLike,
    told: _Told,
) -> Construction:
    done = told.known(tries)
    missing = [index for index in range(tries) if index not in done]
    work = partial(run_attempt, settings)
    run = completed(
        work, missing, len(missing), workers, executor, finish_on_interrupt=told.kept is not None
    )
    ended: list[Attempt] = []
    failures: list[Failure] = []
    with closing(run) as running, told.tally:
        for index in range(tries):
            while index not in done:
                finished = next(running)
                done[finished.index] = told.ended(finished)
            attempt = done[index]
            if isinstance(attempt, Failure):
                failures.append(attempt)
                continue
            ended.append(attempt)
            if attempt.solved and arrived(settings, attempt):
                method = refined(settings, attempt)
                if method is not None:
                    return Construction(settings, method, attempt, index + 1, tuple(failures))
    if not ended:
        raise RuntimeError(f"the workers of all {tries} tries died: {failures[0].message}")
    best = min(ended, key=lambda one: (*_size(one), one.f))
    return Construction(settings, None, best, tries, tuple(failures))


def _size(attempt: Attempt) -> tuple[float, ...]:
    """Return what makes an attempt a better one before f does, the smaller the better."""
    return not attempt.solved, attempt.stages, attempt.flows or 0


@dataclass
class _Told:
    """Who is to know of tries that end: a function, the line of progress, and a store."""

    settings: ConstructionSettings
    progress: Callable[[Attempt], None] | None
    tally: Tally
    kept: StoredRun | None

    def known(self, tries: int) -> dict[int, Attempt | Failure]:
        """Return the tries that the store has, checked."""
        done: dict[int, Attempt | Failure] = {}
        if self.kept is None:
            return done
        for record in self.kept.records():
            attempt = check_attempt(self.settings, Attempt.from_record(record))
            done[attempt.index] = attempt
            if attempt.index < tries:
                self.tally.had(*self._said(attempt))
        for failure in self.kept.failures():
            done[failure.index] = failure
            if failure.index < tries:
                self.tally.had_failed()
        return done

    def ended(self, finished: Finished[Attempt]) -> Attempt | Failure:
        """Return how a try ended, after recording it."""
        attempt = finished.result
        if attempt is None:
            failure = Failure(finished.index, str(finished.failure))
            if self.kept is not None:
                self.kept.fail(failure)
            self.tally.add_failed()
            return failure
        if self.kept is not None:
            self.kept.append([attempt.record(finished.seconds)])
        self.tally.add(*self._said(attempt))
        if self.progress:
            self.progress(attempt)
        return attempt

    def _said(self, attempt: Attempt) -> tuple[float, bool, tuple[float, ...], str]:
        """Return what the line says of a try."""
        size = f"{attempt.stages} stages"
        if attempt.flows is not None:
            size += f" and {attempt.flows} flows"
        solved = attempt.solved and arrived(self.settings, attempt)
        return attempt.f, solved, _size(attempt), f" with {size}"
