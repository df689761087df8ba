"""Default settings of random starts, and random guesses."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cg.construction.candidate import Candidate
from cg.construction.drop import fixed_entries
from cg.construction.search.shapes import draw_guess
from cg.construction.solvers.system import ConditionSystem, Structure

_FIXED = (0.3, 0.8)  # range of entries that are held fixed


@dataclass(frozen=True)
class StartSettings:
    """Default settings of random starts."""

    stages: int  # with which random starts reach the solution set often enough
    width: float  # guesses are uniform in [-width, width]
    iterations: int
    promising: float  # sum of squares below which the solver runs a second time


_GENERAL = {
    1: StartSettings(1, 1.0, 500, 1e-15),
    2: StartSettings(2, 1.0, 500, 1e-15),
    3: StartSettings(3, 1.0, 500, 1e-15),
    4: StartSettings(5, 1.0, 500, 1e-15),
    5: StartSettings(10, 0.5, 500, 1e-15),
    6: StartSettings(27, 0.5, 500, 1e-15),
    7: StartSettings(51, 0.3, 1000, 1e-15),
}
_STAGE_ORDER_TWO = {
    4: StartSettings(6, 1.0, 200, 1e-12),
    5: StartSettings(10, 0.5, 300, 1e-13),
    6: StartSettings(16, 0.3, 300, 1e-13),
    7: StartSettings(40, 0.3, 300, 1e-13),
}
_MIDDLE = {
    4: StartSettings(6, 1.0, 100, 1e-10),
    5: StartSettings(10, 0.6, 100, 1e-10),
    6: StartSettings(15, 0.5, 150, 1e-12),
    7: StartSettings(36, 0.3, 250, 1e-14),
}


def default_start(order: int, structure: Structure) -> StartSettings:
    """Return the default settings for tableaux.

    Above order seven they are those of order seven, with as many stages as there are equations for.
    Untested are orders 4, 5 and 7 with STAGE_ORDER_TWO, and order 7 with GENERAL.
    """
    known = (_GENERAL, _STAGE_ORDER_TWO, _MIDDLE)[structure]
    if order in known:
        return known[order]
    last = known[max(known)]
    stages = last.stages
    while True:
        system = ConditionSystem.tableau(order, stages, structure=structure)
        if system.movable.size > system.equations:
            return replace(last, stages=stages)
        stages += 1


def tree_start(order: int) -> StartSettings:
    """Return the default settings for commutator-free methods; `stages` isn't used."""
    return StartSettings(1, 0.4, 300 if order < 7 else 1500, 1e-14)


def likely_structure(order: int, stages: int) -> Structure:
    """Return GENERAL up to order five if it has enough unknowns, else MIDDLE if that has enough."""
    general = ConditionSystem.tableau(order, stages)
    if (order >= 4 and stages >= 3) and (order >= 6 or general.movable.size < general.equations):
        middle = ConditionSystem.tableau(order, stages, structure=Structure.MIDDLE)
        if middle.movable.size >= middle.equations:
            return Structure.MIDDLE
    return Structure.GENERAL


def random_candidate(
    system: ConditionSystem, width: float, random: np.random.Generator
) -> Candidate:
    """Return a random guess that satisfies the linear equations of the system's structure."""
    if system.rows is None:
        return Candidate(system, draw_guess(system.order, system.layout, width, random))
    x = random.uniform(-width, width, system.size)
    x[np.setdiff1d(np.arange(system.size), system.movable)] = 0.0
    x[fixed_entries(system)] = random.uniform(*_FIXED)
    if system.structure is Structure.MIDDLE:
        _to_the_middle(x, system.stages)
    return Candidate(system, x)


def _to_the_middle(x: NDArray[np.float64], stages: int) -> None:
    """Shift the weights to sum 1, and the rows to the abscissae of structure MIDDLE."""
    b = x[-stages:]
    b[2:] += (1 - b.sum()) / (stages - 2)
    ends = np.cumsum(b)
    for row in range(2, stages):
        entries = slice(row * (row - 1) // 2, row * (row + 1) // 2)
        x[entries] += (ends[row] - b[row] / 2 - x[entries].sum()) / row
