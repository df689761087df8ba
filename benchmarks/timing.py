"""Times of several ways to do the same, taken in turns."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping

from .record import Row


class Times:
    """Times per call of several contestants: for each its seconds per call, one number a round."""

    def __init__(self, rounds: Mapping[str, list[float]]) -> None:
        self.rounds = rounds

    def median(self, name: str) -> float:
        """Return the median of a contestant's times (s)."""
        return statistics.median(self.rounds[name])

    def ratio(self, name: str, other: str) -> float:
        """Return the median over the rounds of a contestant's time divided by another's."""
        pairs = zip(self.rounds[name], self.rounds[other], strict=True)
        return statistics.median(a / b for a, b in pairs)

    def row(
        self, quantity: str, name: str, unit: str, against: str, other: str, *,
        pieces: tuple[float, float] = (1, 1),
    ) -> Row:  # fmt: skip
        """Return a contestant's time beside another's, per piece of what a call of each does.

        The unit begins with ms or µs.
        """
        scale = {"ms": 1e3, "µs": 1e6}[unit.split(maxsplit=1)[0]]
        here, there = (scale / count for count in pieces)
        pairs = zip(self.rounds[name], self.rounds[other], strict=True)
        ratios = [here * a / (there * b) for a, b in pairs]
        low, ratio, high = statistics.quantiles(ratios, n=4, method="inclusive")
        return Row(
            quantity, here * self.median(name), unit, against, there * self.median(other), ratio,
            spread=(low, high),
        )  # fmt: skip


def measure(
    contestants: Mapping[str, Callable[[], object]], *, rounds: int, seconds: float = 0.1,
    warm_up: bool = True,
) -> Times:  # fmt: skip
    """Call each contestant for about as long in each round, one after the other.

    What else the machine does then disturbs all of them alike. Time is that of the
    processor, over all threads of this process.

    Parameters
    ----------
    contestants : mapping of callables
    rounds : int
    seconds : float, optional
        Aimed at for each contestant in each round; a call that takes longer is made once.
    warm_up : bool, optional
        Whether a call before the first round tells how many fit into `seconds`; otherwise
        each is called once a round.

    Returns
    -------
    Times
    """
    calls = dict.fromkeys(contestants, 1)
    if warm_up:
        for name, contestant in contestants.items():
            contestant()  # the first call imports and fills caches
            begin = time.process_time()
            contestant()
            once = max(time.process_time() - begin, 1e-7)
            calls[name] = max(1, round(seconds / once))
    seconds_per_call: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, contestant in contestants.items():
            begin = time.process_time()
            for _ in range(calls[name]):
                contestant()
            seconds_per_call[name].append((time.process_time() - begin) / calls[name])
    return Times(seconds_per_call)
