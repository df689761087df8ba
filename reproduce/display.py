"""Progress and remaining time of each item, on a terminal or in a file."""

import math
import time
from collections.abc import Callable, Sequence
from typing import TextIO

from cg.construction.runs.progress import ProgressLine, duration

from .context import Item, Progress


class Display:
    """Progress on a stream: an updated line on a terminal, otherwise a line every half minute.

    `items` are all items to run, in order; `clock` returns the time in seconds.
    """

    def __init__(
        self, stream: TextIO, items: Sequence[Item], clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._line = ProgressLine(stream, clock=clock)
        self._places = {
            item.name: f"[{k}/{len(items)}] {item.title}" for k, item in enumerate(items, 1)
        }

    def begin(self, item: Item) -> Progress:
        """Return the function that receives an item's progress."""
        begun = self._line.begin()
        self._line.update(f"{self._places[item.name]}: …", begun)
        stored: int | None = None

        def update(done: int, total: int) -> None:
            nonlocal stored
            if stored is None:  # the first call of this run; a store may have had the parts before
                stored = max(0, done - 1)
            now = self._line.clock()
            text = f"{self._places[item.name]}: {done} of {total}, {duration(now - begun)}"
            if done > stored:  # else there is nothing to judge by
                left = (now - begun) * (total - done) / (done - stored)
                text += f", about {duration(left)} left"
            self._line.update(text, now)

        return update

    def finish(self, item: Item, seconds: float) -> None:
        """Report that an item is finished."""
        text = f"{self._places[item.name]}: {seconds:.1f} s"
        self._line.update(text, math.inf)
        self._line.end(text)
