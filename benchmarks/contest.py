"""Solvers that run the same random starts, each for a given time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import leastsq

from cg import _core_r64
from cg.conditions import table_rows, unknowns
from cg.construction.search.random_search import search
from cg.construction.search.settings import SearchSettings
from cg.construction.search.start import EXACT, random_start, run_start
from cg.construction.solvers.refine import refine
from cg.construction.solvers.system import ConditionSystem
from cg.layouts.layout import Layout
from cg.support import quads

SEED = 1
"""Seed of all random starts."""


@dataclass
class Contestant:
    """A solver, the time it used, and the starts from which it reached an exact method."""

    solve: Callable[[int], bool]
    seconds: float = 0.0
    starts: int = 0
    exact: list[int] = field(default_factory=list)

    def advance(self, until: float) -> None:
        """Run starts, in order, until a number of seconds is used up."""
        while self.seconds < until:
            begin = time.process_time()
            if self.solve(self.starts):
                self.exact.append(self.starts)
            self.seconds += time.process_time() - begin
            self.starts += 1

    @property
    def per_minute(self) -> float:
        """Exact methods a minute."""
        return 60.0 * len(self.exact) / self.seconds


class PaddedResidual:
    """Residuals with rows of zeros for trees that can be discarded, as the paper has them.

    MINPACK refuses fewer residuals than unknowns; more zeros are appended where needed.

    Parameters
    ----------
    order, stages : int
    """

    def __init__(self, order: int, stages: int) -> None:
        self.shape = order, Layout.tableau(stages).code
        rows = np.array(table_rows(order), dtype=np.intc)
        self.trees = np.pad(rows, (0, max(0, unknowns(stages) - len(rows))))
        self.trees_alone = rows[rows > 0]

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the residuals, shape ``(rows,)``."""
        residuals: NDArray[np.float64] = _core_r64.residuals(*self.shape, x, self.trees)
        return residuals

    def jacobian(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives, shape ``(rows, unknowns)``."""
        derivatives = np.zeros((len(self.trees), x.size))
        nonzero = np.flatnonzero(self.trees)
        derivatives[nonzero] = _core_r64.jacobian(*self.shape, x, self.trees_alone)
        return derivatives


def _leastsq(
    residual: PaddedResidual, guess: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Run ``leastsq`` with the paper's tolerances; return where it ended and the sum of squares."""
    x, _, info, _, _ = leastsq(
        residual, guess, full_output=True, xtol=1e-18, ftol=1e-18, gtol=0.0,
        maxfev=200 * (guess.size + 1),
    )  # fmt: skip
    return x, float(np.sum(info["fvec"] ** 2))


def compete(contest: dict[str, Contestant], budget: float, turns: int) -> str:
    """Let contestants run in turns until each has used its time; return a summary."""
    for turn in range(1, turns + 1):
        for contestant in contest.values():
            contestant.advance(turn * budget / turns)
    return ", ".join(
        f"{name} {len(c.exact)} of {c.starts} in {c.seconds:.0f} s" for name, c in contest.items()
    )


def contestants(order: int, stages: int) -> dict[str, Contestant]:
    """Return the fast solver, the paper's, and SciPy's."""
    fast = search(order, stages, 1, SEED, workers=1).settings
    slow = search(order, stages, 1, SEED, algorithm="lmdif", width=fast.width, maxfev=1, workers=1)
    settings = {"minimum-norm": fast, "lmdif": _with_default_budget(slow.settings)}
    contest = {name: Contestant(_searcher(setting)) for name, setting in settings.items()}
    contest["leastsq"] = Contestant(_scipy(order, stages, fast.width))
    return contest


def _with_default_budget(settings: SearchSettings) -> SearchSettings:
    """Return settings with MINPACK's default limit of evaluations."""
    evaluations = 200 * (unknowns(settings.stages, settings.rows) + 1)
    return SearchSettings(**{**vars(settings), "maxfev": evaluations})


def _searcher(settings: SearchSettings) -> Callable[[int], bool]:
    return lambda index: run_start(settings, index).exact


def _scipy(order: int, stages: int, width: float) -> Callable[[int], bool]:
    residual = PaddedResidual(order, stages)
    size = unknowns(stages)

    def solve_start(index: int) -> bool:
        x, f = _leastsq(residual, random_start(SEED, index, size, width))
        if not f <= 1e-15:
            return False
        refined = refine(quads.from_float(x), ConditionSystem.tableau(order, stages))
        scale = max(1.0, float(np.abs(quads.to_float(refined.x)).max()))
        return refined.largest_residual <= EXACT * scale

    return solve_start
