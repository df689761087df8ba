"""Progress and remaining time of each item, on a terminal or in a file."""

from collections.abc import Sequence
from typing import Any, TextIO

from cg.support.parallel import has_bars, make_bar

from .context import Item, Progress

_DELAY = 1.0  # seconds before a bar appears


class Display:
    """A bar of progress for each of all `items` to run, in order, if tqdm is installed."""

    def __init__(self, stream: TextIO, items: Sequence[Item]) -> None:
        self._stream = stream
        self._bar: Any = None
        self._places = {
            item.name: f"[{k}/{len(items)}] {item.title}" for k, item in enumerate(items, 1)
        }

    def begin(self, item: Item) -> Progress:
        """Return the function that receives an item's progress."""
        bar: Any = None
        if has_bars():
            bar = make_bar(self._stream, desc=self._places[item.name], delay=_DELAY)
            self._bar = bar

        def update(done: int, total: int) -> None:
            if bar is not None:
                if bar.total is None:  # the first call; a store may have had the parts before
                    bar.total, bar.initial, bar.n = total, max(0, done - 1), max(0, done - 1)
                bar.update(done - bar.n)

        return update

    def finish(self, item: Item, seconds: float) -> None:
        """Report that an item is finished."""
        self.close()
        print(f"{self._places[item.name]}: {seconds:.1f} s", file=self._stream, flush=True)

    def close(self) -> None:
        """End the line of the bar."""
        if self._bar is not None:
            self._bar.close()
