"""One random start of a search: determined by its settings and index."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import count, table_rows
from cg.construction.layouts import Layout
from cg.construction.search.settings import Settings
from cg.construction.search.shapes import draw_guess, fixed_entries, start_generator
from cg.construction.solvers.held import RegisterWeights
from cg.construction.solvers.lmdif import fit_lmdif
from cg.construction.solvers.minimum_norm import descend, fit_conditions
from cg.construction.solvers.refine import refine
from cg.construction.solvers.system import ConditionSystem
from cg.support import quads
from cg.support.parallel import single_threads, stoppable
from cg.support.shared_numbers import MinimumNormStatus

EXACT = 1e-31
"""A method is exact if no residual of its order conditions, computed in real(16), exceeds
this, relative to its largest coefficient where that is above 1."""

_SOLVED = 1e-25  # with trees: sum of squares below which `descend` would gain nothing
_PROMISING = 1e-11  # with trees: sum of squares below which `descend` is tried


@dataclass(frozen=True)
class SolverCall:
    """The result of one call of a solver."""

    f: float  # sum of squared residuals, or a bound of it
    info: int  # a `LmdifStatus` or `MinimumNormStatus`
    nfev: int  # evaluations of residuals


@dataclass(frozen=True)
class RandomStart:
    """The result of one random start, which its number `index` and the settings determine."""

    index: int
    double: SolverCall
    quad: SolverCall | None  # None if `double` ended above `refine_below`
    x: tuple[str, ...]  # packed coefficients, 36 digits
    max_residual: float  # over all order conditions, in real(16)
    exact: bool  # whether that is rounding error

    @property
    def f(self) -> float:
        """Final sum of squared residuals."""
        return (self.quad or self.double).f

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any]) -> RandomStart:
        """Return the start whose fields `dataclasses.asdict` has returned."""
        double, quad, x = (fields[name] for name in ("double", "quad", "x"))
        calls = {"double": SolverCall(**double), "quad": quad and SolverCall(**quad)}
        return cls(**{**fields, **calls, "x": tuple(x)})


def draw_start(settings: Settings, index: int) -> tuple[Layout, NDArray[np.float64]]:
    """Return the layout and the random coefficients of a start, by the seed and the index alone."""
    generator = start_generator(settings.seed, index)
    layout = settings.layout or settings.tree_for(settings.flows or 0, generator)
    fixed = [] if settings.algorithm == "lmdif" else fixed_entries(settings.order, layout)
    guess = draw_guess(layout, settings.width, generator, fixed)
    return layout, RegisterWeights(layout).guess(guess) if settings.registers else guess


@single_threads()
def run_start(settings: Settings, index: int) -> RandomStart:
    """Run the start of a number: guess, solve in double, refine in real(16)."""
    layout, guess = draw_start(settings, index)
    system = settings.system(layout)
    if settings.algorithm == "lmdif":
        double, refined, bits = _run_lmdif(settings, layout, guess)
    else:
        double, refined, bits = _run_minimum_norm(settings, system, guess)
    if refined is None:
        # most starts end here, with doubles: formatting them is faster than converting fractions
        decimals = tuple(f"{entry:.35e}" for entry in quads.to_float(bits).tolist())
    else:
        decimals = tuple(map(quads.to_decimal, quads.decode(bits)))
        bits = quads.encode(map(Fraction, decimals))
    largest = float(np.abs(system.residual_quad(bits)).max())
    exact = _is_exact(largest, bits)
    return RandomStart(index, double, refined, decimals, _finite(largest), exact)


def _run_lmdif(
    settings: Settings, layout: Layout, guess: NDArray[np.float64]
) -> tuple[SolverCall, SolverCall | None, quads.Quads]:
    trees = np.array(table_rows(settings.order), dtype=np.intc)
    # lmdif requires at least as many rows as unknowns; rows of zeros change nothing
    trees = np.pad(trees, (0, max(0, guess.size - len(trees))))

    def fit(x: NDArray[Any], tolerance: NDArray[Any], maxfev: int) -> tuple[Any, ...]:
        problem = settings.order, layout, x, trees, tolerance, maxfev
        return stoppable(lambda stop_flag: fit_lmdif(*problem, stop_flag))

    x, f, info, nfev = fit(guess, np.array([1e-18]), settings.maxfev)
    double = SolverCall(_finite(f[0]), int(info), int(nfev))
    bits = quads.from_float(x if np.isfinite(x).all() else guess)
    if double.f > settings.refine_below:
        return double, None, bits
    x_quad, f, info, nfev = fit(bits.T, quads.from_float([1e-32]).T, settings.refine_maxfev)
    refined = SolverCall(_finite(quads.to_float(f.T)[0]), int(info), int(nfev))
    x_quad = np.ascontiguousarray(x_quad.T)
    return double, refined, x_quad if np.isfinite(quads.to_float(x_quad)).all() else bits


def _run_minimum_norm(
    settings: Settings, system: ConditionSystem, guess: NDArray[np.float64]
) -> tuple[SolverCall, SolverCall | None, quads.Quads]:
    """Solve in double with some unknowns held, then refine all of them."""
    movable = system.movable_without(fixed_entries(system.order, system.layout))
    fit = fit_conditions(
        guess, system, movable=movable, max_iterations=max(1, settings.maxfev // 2)
    )
    evaluations = fit.evaluations
    if system.rows is None and _SOLVED < fit.f <= _PROMISING:
        fit = descend(system, fit.x, movable)
        evaluations += fit.evaluations
    double, bits = SolverCall(_finite(fit.f), int(fit.status), evaluations), quads.from_float(fit.x)
    if double.f > settings.refine_below:
        return double, None, bits
    refined = refine(bits, system)
    bound = count(settings.order) * refined.max_residual**2
    # Corrections end where they reduce residuals no more, by rounding or far from a solution.
    exact = _is_exact(refined.max_residual, refined.x)
    status = MinimumNormStatus.SOLVED if exact else MinimumNormStatus.NO_DESCENT
    return double, SolverCall(bound, int(status), refined.iterations + 1), refined.x


def _is_exact(max_residual: float, x: quads.Quads) -> bool:
    """Return whether residuals are rounding errors."""
    return max_residual <= EXACT * max(1.0, float(np.abs(quads.to_float(x)).max()))


def _finite(f: float) -> float:
    """Return a number; infinity if it overflowed or isn't one."""
    return float(f) if np.isfinite(f) else np.inf
