"""The command ``reproduce-paper``."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from cg.parallel import available_cores

from .context import Progress, Settings
from .item import Item
from .items import ITEMS, select
from .run import OutputError, check_output, run

__all__ = ["main"]

_UNUSABLE = 2
_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default those of the process.

    Returns
    -------
    int
        Exit status: 0, or 2 if the output folder can't be used or is full, or 130 after an
        interrupt.

    Raises
    ------
    SystemExit
        With status 2, if an argument is wrong; with 0 after ``--help``.
    """
    options = _parser().parse_args(arguments)
    if options.list:
        for item in ITEMS.values():
            print(f"{item.name:16} {item.title}")
        return 0
    try:
        check_output(options.out)
    except OutputError as error:
        print(f"reproduce-paper: error: --out {error}", file=sys.stderr)
        return _UNUSABLE
    items = select(options.only or ITEMS)
    display = _Display(sys.stderr, len(items))
    begun = time.perf_counter()
    try:
        run(
            items,
            options.out,
            Settings(options.seed, options.full),
            options.workers,
            display.begin,
            display.finish,
        )
    except OSError as error:
        print(
            f"\nreproduce-paper: error: {error}; finished items are kept in {options.out}",
            file=sys.stderr,
        )
        return _UNUSABLE
    except KeyboardInterrupt:
        print(
            f"\ninterrupted; finished items and searches are kept in {options.out}",
            file=sys.stderr,
        )
        return _INTERRUPTED
    seconds = time.perf_counter() - begun
    print(f"{options.out / 'report.html'} written in {seconds:.1f} s", file=sys.stderr)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="reproduce-paper",
        description="Reproduce the figures, tables and claims of the paper, and "
        "what goes beyond it, as one report.",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("reproduce/out"), metavar="DIR",
        help="folder for report.html, results.json and figures (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--full", action="store_true", help="the extensive search, with many more starts: hours"
    )
    parser.add_argument(
        "--only", action="append", type=_item, metavar="ITEM",
        help="run this item and what it needs; may be given several times",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=_at_least(0), default=0, help="seed of random starts (default: %(default)s)"
    )
    parser.add_argument(
        "--workers", type=_at_least(1), default=available_cores(), metavar="N",
        help="threads; they don't change the numbers (default: all cores, %(default)s)",
    )  # fmt: skip
    parser.add_argument("--list", action="store_true", help="list the items and exit")
    return parser


def _item(text: str) -> str:
    if text not in ITEMS:
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join(ITEMS)}")
    return text


class _at_least:
    """An integer argument with a lower bound."""

    def __init__(self, least: int) -> None:
        self.least = least

    def __call__(self, text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = self.least - 1
        if value < self.least:
            raise argparse.ArgumentTypeError(
                f"must be an integer, at least {self.least}, got {text!r}"
            )
        return value


class _Display:
    """Progress on a stream: a moving line on a terminal, else a line an item."""

    def __init__(self, stream: TextIO, total: int) -> None:
        self._stream = stream
        self._total = total
        self._finished = 0
        self._terminal = stream.isatty()
        self._begun = self._drawn = 0.0

    def begin(self, item: Item) -> Progress:
        """Return the function that receives an item's progress."""
        self._begun = time.perf_counter()
        self._line(item, "…")

        def update(done: int, total: int) -> None:
            now = time.perf_counter()
            if self._terminal and now - self._drawn >= 0.1:
                self._drawn = now
                self._line(item, f"{done}/{total}, {now - self._begun:.0f} s")

        return update

    def finish(self, item: Item, seconds: float) -> None:
        """Tell that an item is done."""
        self._line(item, f"{seconds:.1f} s", end="\n")
        self._finished += 1

    def _line(self, item: Item, text: str, end: str = "") -> None:
        if self._terminal or end:
            start = "\r\x1b[K" if self._terminal else ""
            place = f"[{self._finished + 1}/{self._total}]"
            self._stream.write(f"{start}{place} {item.title}: {text}{end}")
            self._stream.flush()
