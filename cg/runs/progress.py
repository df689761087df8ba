"""How far a run is, in a line: moving on a terminal, one every half minute in a file."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TextIO

from ..support.checks import check_real

__all__ = ["ProgressLine", "Tally", "check_progress", "duration"]

_REDRAW = 0.1  # seconds between changes of a line on a terminal
_REPORT = 30.0  # and between lines in a file


@dataclass(frozen=True)
class State:
    """How far a run is: pieces of work, those that a store had among them."""

    pieces: str
    done: int
    total: int
    rate: float  # pieces a second, of those that were run now
    best: str  # what the best one came to
    solved: int
    failed: int

    def __str__(self) -> str:
        parts = [f"{self.done} of {self.total} {self.pieces}", f"{self.rate:.3g} a second"]
        if self.best:
            parts.append(f"best {self.best}")
        parts.append(f"{self.solved} solved")
        if self.failed:
            parts.append(f"{self.failed} failed")
        left = self.total - self.done
        if left and self.rate > 0:
            parts.append(f"{duration(left / self.rate)} left")
        return ", ".join(parts)


class ProgressLine:
    """A line that tells how far a search or a construction is.

    It has the number of starts that ended, their rate, the best one, how many led to what was
    wanted, and the time that is left. On a terminal it moves; elsewhere there is one every half
    minute, and if there was one, a last one at the end.

    Parameters
    ----------
    stream : text file, optional
        Standard error by default.
    every : float, optional
        Seconds between lines; by default 0.1 on a terminal and 30 elsewhere.
    clock : callable, optional
        The time in seconds.

    Raises
    ------
    TypeError, ValueError
        If `every` isn't a number, or negative.

    Examples
    --------
    >>> import cg, sys
    >>> from cg.runs import ProgressLine
    >>> line = ProgressLine(sys.stdout, every=0, clock=iter(range(9)).__next__)
    >>> _ = cg.search(2, 2, 2, seed=1, workers=1, progress=line)  # doctest: +ELLIPSIS
    1 of 2 starts, 1 a second, best f ..., 1 solved, 1 s left
    2 of 2 starts, 1 a second, best f ..., 2 solved
    """

    def __init__(
        self,
        stream: TextIO | None = None,
        *,
        every: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        usual = _REDRAW if self._terminal else _REPORT
        self._every = usual if every is None else check_real("every", every)
        self.clock = clock
        self._told = -math.inf
        self._last = ""

    def begin(self) -> float:
        """Begin anew; return the time."""
        now, self._last = self.clock(), ""
        self._told = -math.inf if self._terminal else now
        return now

    def tell(self, state: State, now: float) -> None:
        """Tell a state, if it is time to."""
        if now - self._told >= self._every:
            self._told = now
            self._write(str(state))

    def end(self, state: State) -> None:
        """Tell the last state, if one was told, and leave the line."""
        if self._last and self._last != str(state):
            self._write(str(state))
        if self._last and self._terminal:
            self._put("\n")

    def _write(self, text: str) -> None:
        self._last = text
        self._put(f"\r\x1b[K{text}" if self._terminal else f"{text}\n")

    def _put(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


class Tally:
    """Counts what has ended of a run, and tells it to a line; a context manager that ends that.

    Parameters
    ----------
    line : ProgressLine or None
    pieces : str
        What they are called.
    total : int
    """

    def __init__(self, line: ProgressLine | None, pieces: str, total: int) -> None:
        self.done = self._solved = self._failed = self._here = 0
        self._line, self._pieces, self._total = line, pieces, total
        self._best: tuple[tuple[float, ...], str] | None = None
        self._began = self._now = 0.0

    def __enter__(self) -> Tally:
        if self._line is not None:
            self._began = self._now = self._line.begin()
        return self

    def __exit__(self, *_: object) -> None:
        if self._line is not None and self._here:
            self._line.end(self._state())

    def had(self, f: float, solved: bool, size: tuple[float, ...] = (), note: str = "") -> None:
        """Count a piece that a store had.

        Parameters
        ----------
        f : float
            The sum of squared residuals that it came to.
        solved : bool
            Whether it led to what was wanted.
        size : tuple of float, optional
            What makes one better before f does.
        note : str, optional
            What else is said of it if it is the best one.
        """
        self.done += 1
        self._solved += solved
        value = f if math.isfinite(f) else math.inf
        if self._best is None or (*size, value) < self._best[0]:
            self._best = (*size, value), f"f {f:.1e}{note}"

    def add(self, f: float, solved: bool, size: tuple[float, ...] = (), note: str = "") -> None:
        """Count a piece that has just ended, as `had` does."""
        self.had(f, solved, size, note)
        self._tell()

    def had_failed(self) -> None:
        """Count a piece whose worker died, of which a store tells."""
        self.done += 1
        self._failed += 1

    def add_failed(self) -> None:
        """Count a piece whose worker has just died."""
        self.had_failed()
        self._tell()

    def _tell(self) -> None:
        self._here += 1
        if self._line is not None:
            self._now = self._line.clock()
            self._line.tell(self._state(), self._now)

    def _state(self) -> State:
        passed = max(self._now - self._began, 1e-9)
        best = "" if self._best is None else self._best[1]
        return State(
            self._pieces, self.done, self._total, self._here / passed, best, self._solved,
            self._failed,
        )  # fmt: skip


def check_progress(progress: Any) -> tuple[Callable[..., None] | None, ProgressLine | None]:
    """Return the function of an argument `progress`, or the line that it asks for.

    Raises
    ------
    TypeError
        If it is neither callable, nor a `ProgressLine`, nor true, false or None.
    """
    if isinstance(progress, ProgressLine):
        return None, progress
    if progress is True:
        return None, ProgressLine()
    if progress is None or progress is False:
        return None, None
    if not callable(progress):
        raise TypeError(
            f"progress must be callable, got {progress!r}; True asks for a line on standard error"
        )
    return progress, None


def duration(seconds: float) -> str:
    """Write a time: ``12 s``, ``3 min``, ``2 h 10 min``."""
    if seconds < 59.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
