"""Times of several ways to do the same, taken in turns."""

from __future__ import annotations

import hashlib
import statistics
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

__all__ = ["Times", "measure", "two_threads"]


class Times:
    """Times per call of several contestants, by round.

    Parameters
    ----------
    rounds : mapping
        For each contestant its seconds per call, one number a round.
    """

    def __init__(self, rounds: Mapping[str, list[float]]) -> None:
        self.rounds = rounds

    def median(self, name: str) -> float:
        """Return the median of a contestant's times (s)."""
        return statistics.median(self.rounds[name])

    def ratio(self, name: str, other: str) -> float:
        """Return the median over the rounds of a contestant's time divided by another's."""
        pairs = zip(self.rounds[name], self.rounds[other], strict=True)
        return statistics.median(a / b for a, b in pairs)


def measure(
    contestants: Mapping[str, Callable[[], object]],
    *,
    rounds: int,
    seconds: float = 0.1,
    warm_up: bool = True,
) -> Times:
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
    found: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, contestant in contestants.items():
            begin = time.process_time()
            for _ in range(calls[name]):
                contestant()
            found[name].append((time.process_time() - begin) / calls[name])
    return Times(found)


def two_threads() -> float:
    """Return the speed of two threads of hashing over twice that of one: what the machine gives.

    Hashing has no lock and hardly any memory to share, so that no ensemble can do better.
    """
    data = bytes(20_000_000)
    ratios = []
    with ThreadPoolExecutor(2) as pool:
        for _ in range(5):
            seconds = []
            for count in (1, 2):
                begin = time.perf_counter()
                list(pool.map(lambda _: hashlib.sha256(data).digest(), range(count)))
                seconds.append(time.perf_counter() - begin)
            ratios.append(seconds[0] / seconds[1])
    return statistics.median(ratios)
