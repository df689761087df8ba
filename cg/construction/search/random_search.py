"""Search for methods: many random starts, each solved in double and refined in real(16).

This is Section 3.2 of Jackiewicz, Marthinsen and Owren. A start is a pure function of
``(seed, index)`` and of the kernels of BLAS, which processors differ in. So on one machine results
don't depend on the number of workers, and any start can be run again alone. Besides tableaux,
methods with several frozen fields a flow are searched for: those of a given tree of points, or of
trees that are drawn with the starts.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

from ...conditions import Rows
from ...runs import ExecutorLike, Failure, LongRun, ProgressLine, Record, RunOptions, Score
from ...support import quads
from ...support.checks import MAX_COUNT, check_integer
from .records import Phase, RandomStart
from .result import SearchResult, StoredStarts
from .settings import SearchArguments, SearchSettings
from .start import EXACT, check_start, random_start, run_start, start_layout

__all__ = [
    "EXACT",
    "Phase",
    "RandomStart",
    "SearchResult",
    "SearchSettings",
    "random_start",
    "run_start",
    "search",
    "start_layout",
]


def search(
    order: int,
    stages: int,
    starts: int,
    seed: int,
    *,
    algorithm: str = "minimum-norm",
    rows: Rows | str = Rows.EXPLICIT,
    width: float | None = None,
    maxfev: int | None = None,
    refine_below: float = 1e-15,
    refine_maxfev: int | None = None,
    workers: int | None = None,
    executor: ExecutorLike = None,
    store: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | ProgressLine | bool | None = None,
    force: bool = False,
    tree: Any = None,
    flows: int | None = None,
    embedded: bool = False,
    first_same_as_last: bool = False,
) -> SearchResult:
    """Search for methods of an order from random starts.

    By default for tableaux of Crouch–Grossman type; with `tree` or `flows` for methods whose
    flows are those of combinations of frozen fields, `cg.CommutatorFree`.

    Parameters
    ----------
    order : int
        Order wanted, between 1 and `cg.conditions.MAX_ORDER`.
    stages : int
        Number of stages, at most 1000.
    starts : int
        Number of random starts.
    seed : int
        Seed of all starts, not negative.
    algorithm : {"minimum-norm", "lmdif"}, optional
        The first uses the exact Jacobian, steps of least norm and a cheap refinement
        (`cg.construction.solvers`: `minimum_norm`, `refine`). ``"lmdif"`` is the paper's:
        differences for the Jacobian, rows of zeros for discarded trees, xtol = ftol =
        1e-18 in double and 1e-32 in real(16).
    rows : {"explicit", "diagonal", "full"} or Rows, optional
        Explicit, diagonally implicit or fully implicit tableaux.
    width : float, optional
        Guesses are uniform in [-width, width]; by default 1 for ``"lmdif"``, and for
        ``"minimum-norm"`` 1 up to order 4, 0.75 for order 5 and 0.3 above, where it finds
        most methods a second; 0.4 with trees.
    maxfev : int, optional
        Bound on evaluations in double; by default 200 (n + 1) for n unknowns, as MINPACK
        has it, for ``"lmdif"``; for ``"minimum-norm"``, where most methods a second are
        found with it, 120 up to order 4, 500 for order 5 and 1000 above; 600 with trees.
    refine_below : float, optional
        A start goes on to real(16) if its sum of squares is at most this.
    refine_maxfev : int, optional
        Bound on evaluations in real(16); by default 20 (n + 1).
    workers : int, optional
        Number of workers; by default all cores, or as many as `executor` has. It doesn't change
        the result.
    executor : Executor, callable or str, optional
        Where starts run: threads of this process by default, ``"processes"``, any
        `concurrent.futures.Executor`, or a function that makes one. With the last two a
        start whose worker dies is reported in `SearchResult.failures`, and the search goes on. It
        doesn't change the result either, unless other machines have other kernels of BLAS: then
        starts of the default algorithm end at other points.
    store : path, optional
        File that receives every finished start (`cg.runs.Store`). The starts that it has of the
        same settings aren't run again; other runs may share it. The first interrupt lets the
        starts that are at work end.
    progress : callable, ProgressLine or bool, optional
        Called with the numbers of finished and of all starts. True tells them on standard error,
        with the rate, the smallest f, how many are exact and the time that is left:
        `cg.runs.ProgressLine`.
    force : bool, optional
        Try even where there are fewer unknowns than independent conditions. Methods may
        exist there, symmetric ones above all. With trees, where many conditions depend on
        each other, those count that are left where flows commute.
    tree : PointTree, method, or sequence, optional
        The shape of the methods. That of a tree or a method with all its weights that aren't
        zero; or ``(parents, stage_points)``, with results from the third entry on if the
        step doesn't lead to the last point, and weights on all stages evaluated by then. `stages`
        must be those of the tree. From order 5 on, the first weight is held at a random value
        while solving in double, which keeps the solver from degenerate limits.
    flows : int, optional
        Draw the tree with each start: so many flows, at least as many as stages.
    embedded : bool, optional
        With `flows`, draw one more flow, from the result, to a second result of order one less.
        Its last weight is held as well. A tree has such a flow or has none.
    first_same_as_last : bool, optional
        With `flows`, the last of the stages is at the result, where the next step begins.

    Returns
    -------
    SearchResult

    Raises
    ------
    TypeError
        If an argument isn't of the type listed.
    ValueError
        If an argument is out of its range, there are too few stages, or `store` is no store.
    OSError
        If the store can't be written, or another process is at work on the same run.
    MissingQuadsError
        If the package was built without quadruple precision.

    Examples
    --------
    >>> found = search(order=2, stages=2, starts=4, seed=1)
    >>> found.methods[0].order
    2
    >>> search(order=4, stages=4, flows=5, starts=10, seed=1).methods[0].exponentials
    5
    """
    settings = SearchArguments(
        order=order,
        stages=stages,
        seed=seed,
        algorithm=algorithm,
        rows=rows,
        width=width,
        maxfev=maxfev,
        refine_below=refine_below,
        refine_maxfev=refine_maxfev,
        force=force,
        tree=tree,
        flows=flows,
        embedded=embedded,
        first_same_as_last=first_same_as_last,
    ).checked()
    quads.core("cg.search")
    starts = check_integer("starts", starts, 1, MAX_COUNT)
    options = RunOptions.checked(workers, executor, store, progress)
    return _run(settings, starts, options)


def _run(settings: SearchSettings, starts: int, options: RunOptions) -> SearchResult:
    """Run the starts that the store doesn't have; keep them in memory only without a store."""
    drawn = settings.flows is not None

    def to_record(start: RandomStart, seconds: float) -> Record:
        layout = start_layout(settings, start.index)
        return start.record(layout, drawn=drawn, seconds=seconds)

    run = LongRun(
        kind="search",
        pieces="starts",
        settings=settings,
        work=partial(run_start, settings),
        to_record=to_record,
        from_record=lambda record: check_start(settings, RandomStart.from_record(record)),
        score=lambda start: Score(start.f, start.exact),
    )
    finished: list[RandomStart] = []
    failures: list[Failure] = []
    with run.running(starts, options) as (stored, results):
        for _, result in results:
            if isinstance(result, Failure):
                failures.append(result)
            elif stored is None:
                finished.append(result)
    index = attrgetter("index")
    all_starts: Sequence[RandomStart] = tuple(sorted(finished, key=index))
    if stored is not None:
        all_starts = StoredStarts(stored.path, stored.number, starts)
    return SearchResult(settings, all_starts, tuple(sorted(failures, key=index)))
