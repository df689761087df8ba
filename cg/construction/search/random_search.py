"""Search for methods: many random starts, each solved in double and refined in real(16).

This is Section 3.2 of Jackiewicz, Marthinsen and Owren. A start is determined by
``(seed, index)`` and by the BLAS kernels, which differ between processors. So on one machine
results don't depend on the number of workers, and any start can be rerun alone. Besides tableaux,
the search covers methods with several frozen fields in a flow: those of a given tree of points, or
of trees that are drawn at random with each start.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from operator import attrgetter
from typing import Any

import numpy as np

from cg.construction.conditions import Rows
from cg.construction.layouts import Layout
from cg.construction.methods.method import Method
from cg.construction.methods.tolerance import to_floats
from cg.construction.runs import run_pieces
from cg.construction.search.candidate import Candidate, default_name
from cg.construction.search.requirements import Requirements
from cg.construction.search.settings import Settings
from cg.construction.search.start import RandomStart, draw_start, run_start
from cg.support import flint, quads
from cg.support.checks import MAX_COUNT, check_integer
from cg.support.parallel import ExecutorLike, single_threads

_APART = 1e-4  # distance of coefficients of methods that count as distinct after they were moved


@dataclass(frozen=True, repr=False)
class SearchResult:
    """All starts of a search, ordered by index."""

    settings: Settings
    starts: tuple[RandomStart, ...]
    requirements: Requirements = field(default_factory=Requirements)  # on `methods`

    def __repr__(self) -> str:
        settings = self.settings
        required = f", methods required to have {self.requirements}" * bool(str(self.requirements))
        return (
            f"<SearchResult: order {settings.order}, {settings.stages} stages, seed "
            f"{settings.seed}: {self.exact_starts} of {len(self.starts)} starts exact{required}>"
        )

    @property
    def exact_starts(self) -> int:
        """Number of starts that solved the order conditions, whatever else is required."""
        return sum(start.exact for start in self.starts)

    @cached_property
    def methods(self) -> tuple[Method, ...]:
        """The distinct exact methods that satisfy the requirements, the best one first.

        Coefficients have 36 digits, corrected in rational arithmetic beyond the accuracy of
        real(16).
        """
        methods: list[Method] = []
        seen: set[tuple[Layout, tuple[float, ...]]] = set()
        for start in filter(attrgetter("exact"), self.starts):
            layout, _ = draw_start(self.settings, start.index)
            key = layout, tuple(round(float(entry), 8) for entry in start.x)
            if key not in seen:
                seen.add(key)
                methods += [method for method in [self._method(start, layout)] if method]
        methods.sort(key=self.requirements.key)
        if self.requirements == Requirements():
            return tuple(methods)
        distinct: list[Method] = []  # starts that moved to one minimum end close to each other
        for method in methods:
            x = to_floats(method.coefficients)
            if not any(
                known.layout == method.layout
                and np.abs(to_floats(known.coefficients) - x).max() < _APART
                for known in distinct
            ):
                distinct.append(method)
        return tuple(distinct)

    @property
    def best(self) -> RandomStart:
        """The start with the smallest residual, whether exact or not."""
        return min(self.starts, key=attrgetter("max_residual"))

    @single_threads()
    def _method(self, start: RandomStart, layout: Layout) -> Method | None:
        settings = self.settings
        system = settings.system(layout)
        return self.requirements.method(
            Candidate(system, np.array(start.x, dtype=np.float64)),
            name=default_name(system, settings.seed, start.index),
            source=f"search, {settings.algorithm}, seed {settings.seed}, start {start.index}",
        )


def search(
    order: int, stages: int, starts: int = 100, seed: int = 0, *, algorithm: str = "minimum-norm",
    rows: Rows | str = Rows.EXPLICIT, width: float | None = None, maxfev: int | None = None,
    refine_below: float = 1e-15, refine_maxfev: int | None = None, workers: int | None = None,
    executor: ExecutorLike = None, store: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | bool | None = None, force: bool = False,
    tree: Any = None, flows: int | None = None, registers: bool = False, embedded: bool = False,
    first_same_as_last: bool = False, abscissae: Sequence[float] | None = None,
    bound: float | Mapping[str, Sequence[float | None]] | None = None,
    nonnegative: str | Sequence[str] = (), minimise: str | None = None,
    hold: Mapping[str, Any] | None = None,
) -> SearchResult:  # fmt: skip
    """Search for methods of an order from random starts.

    The methods are tableaux of Crouch–Grossman type; with `tree` or `flows` they are
    `cg.CommutatorFree` methods, whose flows are those of combinations of frozen fields.

    Parameters
    ----------
    order
        Order of the methods, between 1 and `cg.conditions.MAX_ORDER`.
    stages
        Number of stages, at most 1000.
    starts
        Number of random starts.
    seed
        Seed of all starts, not negative.
    algorithm
        One of ``"minimum-norm"``, ``"lmdif"``. The first uses the exact Jacobian, steps of least
        norm and a cheap refinement (`cg.construction.solvers`: `minimum_norm`, `refine`). Of
        explicit methods from order 5 on, it holds the first weight at a random value while solving
        in double, which keeps it away from degenerate limits.
        ``"lmdif"`` is that of the paper: a Jacobian from differences, rows of zeros for discarded
        trees, xtol = ftol = 1e-18 in double and 1e-32 in real(16).
    rows
        One of ``"explicit"``, ``"diagonal"``, ``"full"``. Explicit, diagonally implicit or fully
        implicit tableaux.
    width
        Guesses are uniform in [-width, width]. The default is 1 for ``"lmdif"``. For
        ``"minimum-norm"`` it is the value that found most methods per second in experiments: 1 up
        to order 4, 0.75 for order 5 and 0.3 above; 0.4 with trees, 0.7 with registers.
    maxfev
        Largest number of evaluations in double. The default for ``"lmdif"`` is 200 (n + 1) for n
        unknowns, as in MINPACK; for ``"minimum-norm"`` it is chosen as for `width`: 120 up to
        order 4, 500 for order 5 and 1000 above; 600 with trees or registers.
    refine_below
        A start is refined in real(16) if its sum of squares is at most this.
    refine_maxfev
        Largest number of evaluations in real(16); by default 20 (n + 1).
    workers
        Number of workers; by default that of `executor`, or of cores. It doesn't change the
        result.
    executor
        Where starts run: threads of this process by default, ``"processes"``, or any
        `concurrent.futures.Executor`. It doesn't change the result either, unless other machines
        have other BLAS kernels: then starts of the default algorithm end at other points.
    store
        File to which every finished start is appended, one line each. Starts with the same
        settings that it already has aren't run again. Several runs and processes can share a
        file. After the first interrupt, running starts finish.
    progress
        Called with the numbers of finished and of all starts. True shows a bar of tqdm on
        standard error.
    force
        Try even if there are fewer unknowns than independent conditions. Methods may still
        exist, symmetric ones in particular. With trees, where many conditions depend on each
        other, the conditions are counted that remain where flows commute.
    tree
        The shape of the methods. A tree or a method has its nonzero weights as unknowns. A
        sequence is ``(parents, stage_points)``, followed by the results if the last point isn't
        the result; each flow then has weights on all stages before it. `stages` must be that of
        the tree.
    flows
        Number of flows, at least that of stages, of trees drawn at random with each start.
    registers
        Search for commutator-free methods with two registers, `cg.CommutatorFree` methods of the
        form of the page on low-storage methods. Up to order three the last stage of a pair is at
        the result.
    embedded
        Search for pairs, whose second result has order q - 1. A tableau has a second row of
        weights for it, the last one zero. With `flows`, one more flow leads from the result to it,
        whose last weight is held while solving. With `tree`, the tree decides.
    first_same_as_last
        With `flows`, whether the last stage is at the result, where the next step begins.
    abscissae
        Interval that all abscissae of the methods must lie in.
    bound
        Bound on the magnitudes of the coefficients of the methods. Or intervals by name, such as
        ``{"b[2]": (0, 0.5), "a": (-1, 1), "c[3]": (None, 1)}``: names are those of `hold`, and a,
        b, b_embedded, c, w for all of a kind.
    nonnegative
        Name, or names, of what must not be negative, as in `bound`. From order three on no method
        has ``b`` without a negative weight.
    minimise
        One of ``"principal_error"``, ``"largest_coefficient"``. Move each method along its solution
        set to reduce this, and sort the methods by it. Each minimum is a local one: more starts may
        lead to smaller ones. Methods beyond the bounds of `abscissae`, `bound` and `nonnegative`
        are moved as well, to 1 % inside, and left out if that fails. None of the four changes the
        starts, or what a store has.
    hold
        Values of coefficients and abscissae that are prescribed, such as ``{"a[2,1]": "1/2",
        "b[3]": 0, "c[4]": 1}``, of methods with a `tree` weights ``w[3,1]`` of point 3 and stage 1.
        The solver varies the others. Methods have held coefficients as exact rationals, and held
        abscissae to the last digit.

    Examples
    --------
    >>> result = search(order=2, stages=2)
    >>> result.methods[0].order
    2
    >>> search(order=4, stages=4, flows=5, starts=10, seed=1).methods[0].exponentials
    5

    Methods with abscissae in [0, 1], the smallest principal error first:

    >>> result = search(3, 3, 6, seed=1, abscissae=(0, 1), bound=1.5, minimise="principal_error")
    >>> method = result.methods[0]
    >>> method.name, method.order, bool(method.c.max() <= 1)
    ('CG3-1-1', 3, True)

    Methods with prescribed abscissae and a weight of zero:

    >>> hold = {"c[2]": "1/3", "c[3]": "2/3", "b[2]": 0}
    >>> method = search(3, 4, seed=1, hold=hold).methods[0]
    >>> method.c.round(15)[1:3], method.weights[1].text
    (array([0.33333333, 0.66666667]), '0')
    """
    settings = Settings.checked(
        "search", force, order, stages, seed, hold=hold, algorithm=algorithm, rows=rows,
        width=width, maxfev=maxfev, refine_below=refine_below, refine_maxfev=refine_maxfev,
        tree=tree, flows=flows, registers=registers, embedded=embedded,
        first_same_as_last=first_same_as_last,
    )  # fmt: skip
    quads.core("cg.search")
    _ = flint.ctx  # an error if it is missing, by which results are refined
    starts = check_integer("starts", starts, 1, MAX_COUNT)
    requirements = Requirements.checked(order, abscissae, bound, minimise, nonnegative)
    requirements.check(settings.order, settings.layout, force)
    results = run_pieces(
        settings, partial(run_start, settings), starts,
        read=RandomStart.of_fields, solved=attrgetter("exact"),
        workers=workers, executor=executor, store=store, progress=progress,
    )  # fmt: skip
    finished = tuple(sorted(results, key=attrgetter("index")))
    return SearchResult(settings, finished, requirements)
