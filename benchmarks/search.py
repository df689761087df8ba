"""Number of exact methods of orders four and five found per minute of one core."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from cg.construction.conditions import unknowns
from cg.construction.search.random_search import search
from cg.construction.search.settings import Settings
from cg.construction.search.start import run_start

from .record import Result, Row

_CASES = ((4, 5), (5, 9))
"""Order and stages."""

_SEED = 1

TITLE = "Searches"


def method_text(budget: float, turns: int) -> str:
    """Return how searches are measured."""
    return (
        f"Both solvers run the same random starts, {budget:.0f} s of one core each, in {turns} "
        "turns. A method is exact if all order conditions hold to 1e-31 in real(16)."
    )


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


def run(quick: bool) -> Result:
    """Run two solvers on the same starts, in turns, each for the same time."""
    budget, turns = (3.0, 2) if quick else (24.0, 8)
    rows, notes = [], []
    for order, stages in _CASES:
        contest = contestants(order, stages)
        for turn in range(1, turns + 1):
            for contestant in contest.values():
                contestant.advance(turn * budget / turns)
        ours, other = contest["minimum-norm"], contest["lmdif"]
        rows.append(Row(
            f"exact methods of order {order}, {stages} stages", ours.per_minute,
            "per core-minute", '`algorithm="lmdif"`, as in the paper', other.per_minute,
            ours.per_minute / max(other.per_minute, 60.0 / other.seconds),
        ))  # fmt: skip
        counts = ", ".join(
            f"{name} {len(c.exact)} of {c.starts} in {c.seconds:.0f} s"
            for name, c in contest.items()
        )
        notes.append(f"- Order {order}, exact methods of all starts: {counts}.")
    return Result(TITLE, method_text(budget, turns), tuple(rows), ("\n".join(notes),))


def contestants(order: int, stages: int) -> dict[str, Contestant]:
    """Return the fast solver, and the paper's with MINPACK's default limit of evaluations."""
    fast = search(order, stages, 1, _SEED, workers=1).settings
    slow = search(
        order, stages, 1, _SEED, algorithm="lmdif", width=fast.width, maxfev=1, workers=1
    ).settings
    evaluations = 200 * (unknowns(stages, slow.rows) + 1)
    slow = Settings(**{**vars(slow), "maxfev": evaluations})
    return {"minimum-norm": _contestant(fast), "lmdif": _contestant(slow)}


def _contestant(settings: Settings) -> Contestant:
    return Contestant(lambda index: run_start(settings, index).exact)
