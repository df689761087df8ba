"""Progress and remaining time of a run, on a terminal or in a file."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TextIO

from cg.runs.progress import duration

from .context import Progress
from .item import Item

__all__ = ["Display", "duration"]

_REDRAW = 0.1  # seconds between changes of a line on a terminal
_REPORT = 30.0  # seconds between lines in a file
_TRUST = 10.0  # seconds after which the speed of this run outweighs the stored costs


class Display:
    """Progress on a stream: an updated line on a terminal, otherwise a line every half minute.

    Parameters
    ----------
    stream : TextIO
    items : sequence of Item
        All items to run, in order.
    full : bool
        Whether the extensive search runs.
    limit : float, optional
        Largest time of a search in seconds.
    clock : callable, optional
        Returns the time in seconds.
    """

    def __init__(
        self,
        stream: TextIO,
        items: Sequence[Item],
        full: bool = False,
        limit: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._stream = stream
        self._items = items
        self._costs = [item.cost[full] for item in items]
        self._limit = limit
        self._clock = clock
        self._finished = 0
        self._terminal = stream.isatty()
        self._start = self._begun = self._drawn = clock()
        self._spent = 0.0  # costs of finished items
        self._already: int | None = None  # parts read from a checkpoint
        self._share = 0.0  # part of the item that this run has computed

    def begin(self, item: Item) -> Progress:
        """Return the function that receives an item's progress."""
        self._begun = self._clock()
        self._already, self._share = None, 1.0
        if self._terminal:
            self._line(item, "…")

        def update(done: int, total: int) -> None:
            now = self._clock()
            if self._already is None:
                self._already = max(0, done - 1)
            self._share = (done - self._already) / total
            if now - self._drawn >= (_REDRAW if self._terminal else _REPORT):
                self._drawn = now
                self._line(item, f"{done} of {total}, {self._times(now, done, total)}")

        return update

    def finish(self, item: Item, seconds: float) -> None:
        """Report that an item is finished."""
        self._line(item, f"{seconds:.1f} s", end="\n")
        self._spent += self._costs[self._finished] * self._share
        self._finished += 1
        self._drawn = self._clock()

    def _times(self, now: float, done: int, total: int) -> str:
        """Return the time of the item so far, and the remaining times of the item and the run."""
        elapsed = now - self._begun
        left = elapsed * (total - done) / total / max(self._share, 1e-9)
        spent = self._spent + self._costs[self._finished] * self._share
        # starts from the speed at which the costs were measured
        pace = (now - self._start + _TRUST) / (spent + _TRUST)
        later = sum(
            self._bounded(k, pace * self._costs[k])
            for k in range(self._finished + 1, len(self._items))
        )
        left = self._bounded(self._finished, left, elapsed)
        text = f"{duration(elapsed)}, about {duration(left)} left"
        if self._finished + 1 < len(self._items):
            text += f", {duration(left + later)} for all"
        return text

    def _bounded(self, index: int, seconds: float, elapsed: float = 0.0) -> float:
        if self._limit is None or not self._items[index].limited:
            return seconds
        return min(seconds, max(0.0, self._limit - elapsed))

    def _line(self, item: Item, text: str, end: str = "") -> None:
        start, end = ("\r\x1b[K", end) if self._terminal else ("", "\n")
        place = f"[{self._finished + 1}/{len(self._items)}]"
        self._stream.write(f"{start}{place} {item.title}: {text}{end}")
        self._stream.flush()
