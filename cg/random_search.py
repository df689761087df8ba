"""Search for methods: many random starts, each solved in double and refined in real(16).

This is Section 3.2 of Jackiewicz, Marthinsen and Owren. A start is a pure function of
``(seed, index)``, so results don't depend on the number of workers, and any start can
be run again alone.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from . import _core_r64, _core_r128, quad
from .checkpoint import Checkpoint
from .checks import LARGEST_COUNT, MOST_STAGES, WIDEST, check_flag, check_integer, check_real
from .conditions import (
    HIGHEST_ORDER,
    Rows,
    check_rows,
    count,
    table_rows,
    unknowns,
)
from .layout import Layout
from .parallel import as_finished, available_cores, stoppable
from .search_records import Phase, RandomStart, SearchSettings
from .solve.minimum_norm import fit_conditions
from .solve.polish import polish
from .solve.refine import refine
from .solve.system import ConditionSystem
from .tableau import Tableau

__all__ = [
    "EXACT",
    "Phase",
    "RandomStart",
    "SearchResult",
    "SearchSettings",
    "random_start",
    "run_start",
    "search",
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

_NOTHING = Fraction(1, 10**40)  # corrections leave this much of a coefficient that is zero


@dataclass(frozen=True)
class SearchResult:
    """All starts of a search, in the order of their index.

    Attributes
    ----------
    settings : SearchSettings
    starts : tuple of RandomStart
    """

    settings: SearchSettings
    starts: tuple[RandomStart, ...]

    @cached_property
    def methods(self) -> tuple[Tableau, ...]:
        """The exact methods found, distinct, smallest largest coefficient first.

        Their coefficients have 36 digits, corrected beyond real(16) in rational arithmetic.
        """
        found: list[tuple[float, Tableau]] = []
        seen: set[tuple[float, ...]] = set()
        for start in self.starts:
            if not start.exact:
                continue
            key = tuple(round(float(entry), 8) for entry in start.x)
            if key not in seen:
                seen.add(key)
                found.append((max(map(abs, key)), self._tableau(start)))
        return tuple(method for _, method in sorted(found, key=operator.itemgetter(0)))

    @property
    def best(self) -> RandomStart:
        """The start with the smallest residual, whether exact or not."""
        return min(self.starts, key=operator.attrgetter("largest_residual"))

    def _tableau(self, start: RandomStart) -> Tableau:
        settings = self.settings
        name = f"order {settings.order}, {settings.stages} stages, start {start.index}"
        source = f"search, {settings.algorithm}, seed {settings.seed}, start {start.index}"
        # the last places that real(16) leaves may not be right to the digits that are written
        polished = polish(
            list(map(Fraction, start.x)),
            ConditionSystem.tableau(settings.order, settings.stages, settings.rows),
        )
        return Tableau.from_packed(
            [entry if abs(entry) > _NOTHING else Fraction() for entry in polished.x],
            settings.stages,
            settings.rows,
            digits=quad.DECIMAL_DIGITS,
            name=name,
            source=source,
        )


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
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    return generator.uniform(-width, width, size)


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
) -> SearchResult:
    """Search for methods of an order from random starts.

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
        most methods a second.
    maxfev : int, optional
        Bound on evaluations in double; by default 200 (n + 1) for n unknowns, as MINPACK
        has it, for ``"lmdif"``; for ``"minimum-norm"``, where most methods a second are
        found with it, 120 up to order 4, 500 for order 5 and 1000 above.
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
        exist there, symmetric ones above all.

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
        If the checkpoint can't be written.

    Examples
    --------
    >>> found = search(order=2, stages=2, starts=4, seed=1)
    >>> found.methods[0].order
    2
    """
    settings = _settings(
        order, stages, seed, algorithm, rows, width, maxfev, refine_below, refine_maxfev, force
    )
    starts = check_integer("starts", starts, 1, LARGEST_COUNT)
    if progress is not None and not callable(progress):
        raise TypeError(f"progress must be callable, got {progress!r}")
    workers = check_integer("workers", workers, 1) if workers is not None else available_cores()
    checkpoint_file = (
        Checkpoint.open(checkpoint, asdict(settings)) if checkpoint is not None else None
    )
    try:
        records = map(RandomStart.from_record, checkpoint_file.records if checkpoint_file else ())
        done = {start.index: start for start in records}
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
    size = unknowns(settings.stages, settings.rows)
    guess = random_start(settings.seed, index, size, settings.width)
    run = _run_lmdif if settings.algorithm == "lmdif" else _run_minimum_norm
    double, refined, bits = run(settings, guess)
    if refined is None:
        # doubles, whose decimals take less time without fractions; most starts end here
        decimals = tuple(f"{entry:.35e}" for entry in quad.to_float(bits).tolist())
    else:
        decimals = tuple(map(quad.to_decimal, quad.decode(bits)))
        bits = quad.encode(map(Fraction, decimals))
    system = ConditionSystem.tableau(settings.order, settings.stages, settings.rows)
    largest = float(np.abs(system.residual_quad(bits)).max())
    if not np.isfinite(largest):
        largest = np.inf
    scale = max(1.0, float(np.abs(quad.to_float(bits)).max()))
    return RandomStart(index, double, refined, decimals, largest, largest <= EXACT * scale)


def _run_lmdif(
    settings: SearchSettings, guess: NDArray[np.float64]
) -> tuple[Phase, Phase | None, quad.Quads]:
    trees = np.array(table_rows(settings.order), dtype=np.intc)
    # lmdif refuses fewer rows than unknowns; further rows of zeros change nothing
    trees = np.pad(trees, (0, max(0, guess.size - len(trees))))
    shape = settings.order, Layout.tableau(settings.stages, settings.rows).code
    x, f, info, nfev = stoppable(
        lambda stop_flag: _core_r64.fit_lmdif(
            *shape, guess, trees, [1e-18], [1e-18], settings.maxfev, stop_flag
        )
    )
    double = Phase(_finite(f[0]), int(info), int(nfev))
    bits = quad.from_float(x if np.isfinite(x).all() else guess)
    if double.f > settings.refine_below:
        return double, None, bits
    tolerance = quad.from_float([1e-32]).T
    found, f, info, nfev = stoppable(
        lambda stop_flag: _core_r128.fit_lmdif(
            *shape, bits.T, trees, tolerance, tolerance, settings.refine_maxfev, stop_flag
        )
    )
    refined = Phase(_finite(quad.to_float(f.T)[0]), int(info), int(nfev))
    found = np.ascontiguousarray(found.T)
    return double, refined, found if np.isfinite(quad.to_float(found)).all() else bits


def _run_minimum_norm(
    settings: SearchSettings, guess: NDArray[np.float64]
) -> tuple[Phase, Phase | None, quad.Quads]:
    system = ConditionSystem.tableau(settings.order, settings.stages, settings.rows)
    fit = fit_conditions(
        guess,
        system,
        max_iterations=max(1, settings.maxfev // 2),
    )
    double, bits = Phase(_finite(fit.f), int(fit.status), fit.evaluations), quad.from_float(fit.x)
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
) -> SearchSettings:
    order = check_integer("order", order, 1)
    if order > HIGHEST_ORDER:
        raise ValueError(f"order must be at most {HIGHEST_ORDER} in this build, got {order}")
    stages = check_integer("stages", stages, 1, MOST_STAGES)
    seed = check_integer("seed", seed, 0)
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm must be one of {', '.join(ALGORITHMS)}, got {algorithm!r}")
    rows = check_rows(rows)
    size, conditions = unknowns(stages, rows), count(order, independent=True)
    if not check_flag("force", force) and size < conditions:
        raise ValueError(
            f"stages = {stages} gives {size} unknowns ({rows.name.lower()} rows) for {conditions} "
            f"independent conditions of order {order}; pass force=True to try all the same"
        )
    if width is None:
        width = 1.0 if algorithm == "lmdif" else _BEST_WIDTHS.get(order, _WIDTH_ABOVE)
    width = check_real("width", width, most=WIDEST)
    refine_below = check_real("refine_below", refine_below)
    if maxfev is None:
        best = _BEST_BOUNDS.get(order, _BOUND_ABOVE)
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
    )
