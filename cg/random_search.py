"""Search for methods: many random starts, each solved in double and refined in real(16).

This is Section 3.2 of Jackiewicz, Marthinsen and Owren. A start is a pure function of
``(seed, index)``, so results don't depend on the number of workers, and any start can
be run again alone. Besides tableaux, methods with several frozen fields a flow are searched
for: those of a given tree of points, or of trees that are drawn with the starts.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import quad
from .checkpoint import Checkpoint
from .checks import LARGEST_COUNT, MOST_STAGES, WIDEST, check_flag, check_integer, check_real
from .commutator_free import CommutatorFree
from .compiled_conditions import fit_lmdif
from .conditions import (
    Rows,
    check_rows,
    count,
    table_rows,
    unknowns,
)
from .layout import Layout
from .method import Method
from .parallel import as_finished, available_cores, single_threads, stoppable
from .search_records import Phase, RandomStart, SearchSettings
from .solve.minimum_norm import fit_conditions
from .solve.polish import polish
from .solve.refine import refine
from .solve.singular import finish
from .solve.system import ConditionSystem
from .tableau import Tableau
from .tree_shapes import (
    check_order,
    check_points,
    draw_guess,
    draw_layout,
    held_weights,
    most_unknowns,
)

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

ALGORITHMS = ("minimum-norm", "lmdif")

EXACT = 1e-31
"""A method is exact if no residual of its order conditions, computed in real(16), exceeds
this, relative to its largest coefficient where that is above 1."""


# Half the side of the cube of guesses, and evaluations allowed, by order: where the fast solver
# was measured to find most methods a second. Starts that are going to succeed do so early.
_BEST_WIDTHS = {1: 1.0, 2: 1.0, 3: 1.0, 4: 1.0, 5: 0.75}
_WIDTH_ABOVE = 0.3
_BEST_BOUNDS = {1: 120, 2: 120, 3: 120, 4: 120, 5: 500}
_BOUND_ABOVE = 1000

_TREE_WIDTH = 0.4
_TREE_BOUND = 600
_SOLVED = 1e-25
_PROMISING = 1e-11  # sum of squares from which on the last stretch is tried, with trees

_NOTHING = Fraction(1, 10**40)  # corrections leave this much of a coefficient that is zero


@dataclass(frozen=True, repr=False)
class SearchResult:
    """All starts of a search, in the order of their index.

    Attributes
    ----------
    settings : SearchSettings
    starts : tuple of RandomStart
    """

    settings: SearchSettings
    starts: tuple[RandomStart, ...]

    def __repr__(self) -> str:
        settings = self.settings
        exact = sum(start.exact for start in self.starts)
        return (
            f"<SearchResult: order {settings.order}, {settings.stages} stages, seed "
            f"{settings.seed}: {exact} of {len(self.starts)} starts exact>"
        )

    @cached_property
    def methods(self) -> tuple[Method, ...]:
        """The exact methods found, distinct, smallest largest coefficient first.

        Tableaux, or `cg.CommutatorFree` methods of trees. Their coefficients have 36 digits,
        corrected beyond real(16) in rational arithmetic.
        """
        found: list[tuple[float, Method]] = []
        seen: set[tuple[Layout, tuple[float, ...]]] = set()
        for start in self.starts:
            if not start.exact:
                continue
            key = tuple(round(float(entry), 8) for entry in start.x)
            layout = start_layout(self.settings, start.index)
            if (layout, key) not in seen:
                seen.add((layout, key))
                found.append((max(map(abs, key)), self._method(start, layout)))
        return tuple(method for _, method in sorted(found, key=operator.itemgetter(0)))

    @property
    def best(self) -> RandomStart:
        """The start with the smallest residual, whether exact or not."""
        return min(self.starts, key=operator.attrgetter("largest_residual"))

    @single_threads()
    def _method(self, start: RandomStart, layout: Layout) -> Method:
        settings = self.settings
        size = f"{settings.stages} stages"
        if layout.rows is None:
            size += f", {len(layout.parents)} flows"
        name = f"order {settings.order}, {size}, start {start.index}"
        source = f"search, {settings.algorithm}, seed {settings.seed}, start {start.index}"
        # the last places that real(16) leaves may not be right to the digits that are written
        polished = polish(list(map(Fraction, start.x)), ConditionSystem(settings.order, layout))
        x = [entry if abs(entry) > _NOTHING else Fraction() for entry in polished.x]
        if layout.rows is None:
            return CommutatorFree.from_packed(x, layout, name=name, source=source)
        return Tableau.from_packed(
            x,
            settings.stages,
            settings.rows,
            digits=quad.DECIMAL_DIGITS,
            name=name,
            source=source,
        )


def start_layout(settings: SearchSettings, index: int) -> Layout:
    """Return the shape of the methods that a start looks for.

    It is drawn with the start if the settings have flows, so that it depends on the seed and
    the index alone.
    """
    if settings.flows is not None:
        return _drawn(settings, index)[0]
    return settings.tree or Layout.tableau(settings.stages, settings.rows)


def _drawn(settings: SearchSettings, index: int) -> tuple[Layout, NDArray[np.float64]]:
    """Return the shape of a start with a tree, and its random weights."""
    generator = _generator(settings.seed, index)
    layout = settings.tree
    if settings.flows is not None:
        layout = draw_layout(
            settings.stages,
            settings.flows,
            generator,
            embedded=settings.embedded,
            first_same_as_last=settings.first_same_as_last,
        )
    assert layout is not None
    return layout, draw_guess(settings.order, layout, settings.width, generator)


def _generator(seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))


def random_start(seed: int, index: int, size: int, width: float) -> NDArray[np.float64]:
    """Return the random guess of one start, uniform in [-width, width].

    Parameters
    ----------
    seed, index : int
        The generator's seed is spawned from `seed` for each `index`.
    size : int
        Number of unknowns.
    width : float
        Half the side of the cube of guesses.

    Returns
    -------
    ndarray, shape (size,)
    """
    return _generator(seed, index).uniform(-width, width, size)


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
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
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
        Order wanted, between 1 and `cg.conditions.HIGHEST_ORDER`.
    stages : int
        Number of stages, at most 1000.
    starts : int
        Number of random starts.
    seed : int
        Seed of all starts, not negative.
    algorithm : {"minimum-norm", "lmdif"}, optional
        The first uses the exact Jacobian, steps of least norm and a cheap refinement
        (`cg.solve.minimum_norm`, `cg.solve.refine`). ``"lmdif"`` is the paper's:
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
        Number of threads; all cores by default. It doesn't change the result.
    checkpoint : path, optional
        File that receives every finished start at once. If it exists and belongs to the
        same settings, its starts aren't run again. An interrupt drops what is running.
    progress : callable, optional
        Called with the numbers of finished and of all starts.
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
        If an argument is out of its range, there are too few stages, or the checkpoint
        belongs to other settings.
    OSError
        If the checkpoint can't be written, or is in use by another run.
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
    settings = _settings(
        order,
        stages,
        seed,
        algorithm,
        rows,
        width,
        maxfev,
        refine_below,
        refine_maxfev,
        force,
        tree,
        flows,
        embedded,
        first_same_as_last,
    )
    quad.core("cg.search")
    starts = check_integer("starts", starts, 1, LARGEST_COUNT)
    if progress is not None and not callable(progress):
        raise TypeError(f"progress must be callable, got {progress!r}")
    workers = check_integer("workers", workers, 1) if workers is not None else available_cores()
    checkpoint_file = (
        Checkpoint.open(checkpoint, asdict(settings)) if checkpoint is not None else None
    )
    try:
        records = map(RandomStart.from_record, checkpoint_file.records if checkpoint_file else ())
        done = {start.index: check_start(settings, start) for start in records}
        missing = [index for index in range(starts) if index not in done]
        with closing(as_finished(partial(run_start, settings), missing, workers)) as running:
            for start in running:
                done[start.index] = start
                if checkpoint_file:
                    checkpoint_file.append(start.record())
                if progress:
                    progress(sum(index < starts for index in done), starts)
    finally:
        if checkpoint_file:
            checkpoint_file.close()
    return SearchResult(settings, tuple(done[index] for index in range(starts)))


def check_start(settings: SearchSettings, start: RandomStart) -> RandomStart:
    """Return a start that was read, after computing again what it says of its coefficients.

    Raises
    ------
    ValueError
        If its index is none, or the residual of its coefficients is another.
    """
    where = f"not the record of a start: start {start.index}"
    if not 0 <= start.index <= LARGEST_COUNT:
        raise ValueError(f"{where} can't be")
    system = ConditionSystem(settings.order, start_layout(settings, start.index))
    try:
        bits = quad.encode(start.x)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{where}: {error}") from None
    if len(bits) != system.size:
        raise ValueError(f"{where} has {len(bits)} coefficients, not {system.size}")
    largest, exact = _judged(system, bits)
    if (largest, exact) != (start.largest_residual, start.exact):
        raise ValueError(
            f"{where} says that its largest residual is {start.largest_residual!r}, exact: "
            f"{start.exact}; it is {largest!r}, exact: {exact}"
        )
    return start


def _judged(system: ConditionSystem, bits: quad.Quads) -> tuple[float, bool]:
    """Return the largest residual at binary128 coefficients, and whether they are exact."""
    largest = float(np.abs(system.residual_quad(bits)).max())
    if not np.isfinite(largest):
        largest = np.inf
    scale = max(1.0, float(np.abs(quad.to_float(bits)).max()))
    return largest, largest <= EXACT * scale


@single_threads()
def run_start(settings: SearchSettings, index: int) -> RandomStart:
    """Run one start alone: guess, solve in double, refine in real(16).

    Parameters
    ----------
    settings : SearchSettings
        From `SearchResult.settings`.
    index : int
        Number of the start.

    Returns
    -------
    RandomStart
    """
    if settings.flows is None and settings.tree is None:
        layout = Layout.tableau(settings.stages, settings.rows)
        guess = random_start(settings.seed, index, layout.size, settings.width)
        held = []
    else:
        layout, guess = _drawn(settings, index)
        held = held_weights(settings.order, layout)
    system = ConditionSystem(settings.order, layout)
    if settings.algorithm == "lmdif":
        double, refined, bits = _run_lmdif(settings, layout, guess)
    else:
        double, refined, bits = _run_minimum_norm(settings, system, guess, held)
    if refined is None:
        # doubles, whose decimals take less time without fractions; most starts end here
        decimals = tuple(f"{entry:.35e}" for entry in quad.to_float(bits).tolist())
    else:
        decimals = tuple(map(quad.to_decimal, quad.decode(bits)))
        bits = quad.encode(map(Fraction, decimals))
    return RandomStart(index, double, refined, decimals, *_judged(system, bits))


def _run_lmdif(
    settings: SearchSettings, layout: Layout, guess: NDArray[np.float64]
) -> tuple[Phase, Phase | None, quad.Quads]:
    trees = np.array(table_rows(settings.order), dtype=np.intc)
    # lmdif refuses fewer rows than unknowns; further rows of zeros change nothing
    trees = np.pad(trees, (0, max(0, guess.size - len(trees))))
    shape = settings.order, layout
    x, f, info, nfev = stoppable(
        lambda stop_flag: fit_lmdif(
            *shape, guess, trees, np.array([1e-18]), settings.maxfev, stop_flag
        )
    )
    double = Phase(_finite(f[0]), int(info), int(nfev))
    bits = quad.from_float(x if np.isfinite(x).all() else guess)
    if double.f > settings.refine_below:
        return double, None, bits
    tolerance = quad.from_float([1e-32]).T
    found, f, info, nfev = stoppable(
        lambda stop_flag: fit_lmdif(
            *shape, bits.T, trees, tolerance, settings.refine_maxfev, stop_flag
        )
    )
    refined = Phase(_finite(quad.to_float(f.T)[0]), int(info), int(nfev))
    found = np.ascontiguousarray(found.T)
    return double, refined, found if np.isfinite(quad.to_float(found)).all() else bits


def _run_minimum_norm(
    settings: SearchSettings,
    system: ConditionSystem,
    guess: NDArray[np.float64],
    held: list[int],
) -> tuple[Phase, Phase | None, quad.Quads]:
    """Solve, with some unknowns held until refinement."""
    free = np.setdiff1d(system.free, held)
    fit = fit_conditions(
        guess,
        system,
        free=free,
        max_iterations=max(1, settings.maxfev // 2),
    )
    x, f = fit.x, fit.f
    if system.rows is None and _SOLVED < f <= _PROMISING:
        x, f = finish(system, x, free)
    double, bits = Phase(_finite(f), int(fit.status), fit.evaluations), quad.from_float(x)
    if double.f > settings.refine_below:
        return double, None, bits
    refined = refine(bits, system)
    count_all = count(settings.order)
    bound = count_all * refined.largest_residual**2
    return double, Phase(bound, int(fit.status), refined.iterations + 1), refined.x


def _finite(f: float) -> float:
    """Return a sum of squares, infinite where it overflowed or isn't a number."""
    return float(f) if np.isfinite(f) else np.inf


def _settings(
    order: int,
    stages: int,
    seed: int,
    algorithm: str,
    rows: Rows | str,
    width: float | None,
    maxfev: int | None,
    refine_below: float,
    refine_maxfev: int | None,
    force: bool,
    tree: Any,
    flows: int | None,
    embedded: bool,
    first_same_as_last: bool,
) -> SearchSettings:
    order = check_order(order)
    stages = check_integer("stages", stages, 1, MOST_STAGES)
    seed = check_integer("seed", seed, 0)
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm must be one of {', '.join(ALGORITHMS)}, got {algorithm!r}")
    rows = check_rows(rows)
    force = check_flag("force", force)
    size, conditions = unknowns(stages, rows), count(order, independent=True)
    layout = None
    of_points = tree is not None or flows is not None
    if of_points:
        layout, flows = check_points(
            order, stages, tree, flows, embedded, force, first_same_as_last
        )
        size = most_unknowns(stages, flows) if layout is None else layout.size
        if rows is not Rows.EXPLICIT:
            raise ValueError(f"rows must be explicit with a tree, got {rows.name.lower()}")
        if algorithm == "lmdif" and (embedded or (layout is not None and layout.pair)):
            raise ValueError("algorithm must be 'minimum-norm' for pairs, got 'lmdif'")
    elif check_flag("embedded", embedded):
        raise ValueError("embedded needs a number of flows, got a search for tableaux")
    elif check_flag("first_same_as_last", first_same_as_last):
        raise ValueError("first_same_as_last needs a number of flows, got a search for tableaux")
    elif not force and size < conditions:
        raise ValueError(
            f"stages = {stages} gives {size} unknowns ({rows.name.lower()} rows) for {conditions} "
            f"independent conditions of order {order}; pass force=True to try all the same"
        )
    if width is None:
        best_width = _TREE_WIDTH if of_points else _BEST_WIDTHS.get(order, _WIDTH_ABOVE)
        width = 1.0 if algorithm == "lmdif" else best_width
    width = check_real("width", width, most=WIDEST)
    refine_below = check_real("refine_below", refine_below)
    if maxfev is None:
        best = _TREE_BOUND if of_points else _BEST_BOUNDS.get(order, _BOUND_ABOVE)
        maxfev = 200 * (size + 1) if algorithm == "lmdif" else best
    maxfev = check_integer("maxfev", maxfev, 1, LARGEST_COUNT)
    if refine_maxfev is None:
        refine_maxfev = 20 * (size + 1)
    refine_maxfev = check_integer("refine_maxfev", refine_maxfev, 1, LARGEST_COUNT)
    return SearchSettings(
        order,
        stages,
        seed,
        algorithm,
        rows,
        width,
        maxfev,
        refine_below,
        refine_maxfev,
        flows if layout is None else None,
        bool(embedded),
        layout,
        bool(first_same_as_last),
    )
