"""Progress of long runs as one line: redrawn on a terminal, every 30 seconds in a file."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TextIO

from cg.support.checks import check_real

_REDRAW = 0.1  # seconds between changes of a line on a terminal
_REPORT = 30.0  # seconds between lines in a file


@dataclass(frozen=True)
class Score:
    """How good a result is: the smallest `size`, then f, is the best; `note` is shown after f."""

    f: float
    solved: bool
    size: tuple[float, ...] = ()
    note: str = ""

    @property
    def key(self) -> tuple[float, ...]:
        """What results are sorted by, the best one first."""
        return *self.size, self.f if math.isfinite(self.f) else math.inf


class ProgressLine:
    """A line that shows the progress of a search or a construction.

    On a terminal it is redrawn. In a file, a line is written every 30 seconds, and a last one at
    the end if there was one before. `stream` is standard error by default, `every` the seconds
    between lines, and `clock` returns the time in seconds.
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
        default = _REDRAW if self._terminal else _REPORT
        self._every = default if every is None else check_real("every", every)
        self.clock = clock
        self._last_time = -math.inf
        self._last_text = ""

    def begin(self) -> float:
        """Begin a run; return the time."""
        now, self._last_text = self.clock(), ""
        self._last_time = -math.inf if self._terminal else now
        return now

    def update(self, text: str, now: float) -> None:
        """Write the text if the time since the last one is long enough."""
        if now - self._last_time >= self._every:
            self._last_time = now
            self._write(text)

    def end(self, text: str) -> None:
        """Write the last text unless nothing was written before, and end the line."""
        if self._last_text and self._last_text != text:
            self._write(text)
        if self._last_text and self._terminal:
            self._put("\n")

    def _write(self, text: str) -> None:
        self._last_text = text
        self._put(f"\r\x1b[K{text}" if self._terminal else f"{text}\n")

    def _put(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


class Tally:
    """Counts of finished pieces, shown on a progress line; a context manager around the run."""

    def __init__(self, line: ProgressLine | None, pieces: str, total: int) -> None:
        self.done = self._solved = self._failed = self._in_this_run = 0
        self._line, self._pieces, self._total = line, pieces, total
        self._best: Score | None = None
        self._began = self._now = 0.0

    def __enter__(self) -> Tally:
        if self._line is not None:
            self._began = self._now = self._line.begin()
        return self

    def __exit__(self, *_: object) -> None:
        if self._line is not None and self._in_this_run:
            self._line.end(str(self))

    def count(self, score: Score | None) -> None:
        """Count a piece that an earlier run finished; None if its worker died."""
        self.done += 1
        if score is None:
            self._failed += 1
            return
        self._solved += score.solved
        if self._best is None or score.key < self._best.key:
            self._best = score

    def report(self, score: Score | None) -> None:
        """Count a piece that has just finished, and update the line."""
        self.count(score)
        self._in_this_run += 1
        if self._line is not None:
            self._now = self._line.clock()
            self._line.update(str(self), self._now)

    def __str__(self) -> str:
        rate = self._in_this_run / max(self._now - self._began, 1e-9)
        parts = [f"{self.done} of {self._total} {self._pieces}", f"{rate:.3g} a second"]
        if self._best is not None:
            f = self._best.key[-1]
            parts.append(f"best f {f:.1e}{self._best.note}")
        parts.append(f"{self._solved} solved")
        if self._failed:
            parts.append(f"{self._failed} failed")
        if self.done < self._total and rate > 0:
            parts.append(f"{duration((self._total - self.done) / rate)} left")
        return ", ".join(parts)


def duration(seconds: float) -> str:
    """Return a time as text: ``12 s``, ``3 min``, ``2 h 10 min``."""
    if seconds < 59.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
