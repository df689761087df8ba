"""The command ``reproduce-paper``."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cg.runs import StoreError
from cg.support.parallel import available_cores

from .checkpoint import DamagedError
from .context import Settings
from .display import Display, duration
from .items import ITEMS, select
from .run import OutputError, check_output, check_settings, run

__all__ = ["main"]

_FOLDER = Path("reproduce/out")
_FULL_FOLDER = _FOLDER / "full"

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
        Exit status: 0; 2 if the output folder cannot be used, is full or has a report with other
        settings; 130 after an interrupt.

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
    settings = Settings(options.seed, options.full)
    out = options.out or (_FULL_FOLDER if options.full else _FOLDER)
    try:
        check_output(out)
        check_settings(out, settings)
    except OutputError as error:
        return _complain(f"--out {error}")
    items = select(options.only or ITEMS)
    limit = None if options.minutes is None else 60.0 * options.minutes
    display = Display(sys.stderr, items, options.full, limit)
    begun = time.perf_counter()
    try:
        with _terminated_as_interrupted():
            run(items, out, settings, options.workers, display.begin, display.finish, limit)
    except (StoreError, DamagedError) as error:
        return _complain(f"{error}; if you delete that file, its content is computed again")
    except OSError as error:
        return _complain(f"{error}; finished items are kept in {out}")
    except KeyboardInterrupt:
        print(f"\ninterrupted; finished items and searches are kept in {out}", file=sys.stderr)
        return _INTERRUPTED
    seconds = time.perf_counter() - begun
    print(f"{out / 'report.html'} written in {duration(seconds)}", file=sys.stderr)
    return 0


def _complain(message: str) -> int:
    print(f"\nreproduce-paper: error: {message}", file=sys.stderr)
    return _UNUSABLE


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Treat SIGTERM, which ends batch jobs, as an interrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="reproduce-paper",
        description="Reproduce the figures, tables and claims of the paper, and "
        "what goes beyond it, as one report.",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="folder for report.html, results.json, figures and checkpoints "
        f"(default: {_FOLDER}, with --full {_FULL_FOLDER})",
    )  # fmt: skip
    parser.add_argument(
        "--full", action="store_true",
        help="the extensive search, with twenty times as many starts: hours",
    )  # fmt: skip
    parser.add_argument(
        "--minutes", type=_minutes, metavar="M",
        help="end each search after M minutes; the report says how far it came, and the same "
        "command continues from there",
    )  # fmt: skip
    parser.add_argument(
        "--only", action=_Names, metavar="ITEM[,ITEM...]",
        help="run these items and what they need; may be given several times",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=_at_least(0), default=0, help="seed of random starts (default: %(default)s)"
    )
    parser.add_argument(
        "--workers", type=_at_least(1), default=available_cores(), metavar="N",
        help="threads; the numbers do not depend on them (default: all cores, %(default)s)",
    )  # fmt: skip
    parser.add_argument("--list", action="store_true", help="list the items and exit")
    return parser


class _Names(argparse.Action):
    """Names of items separated by commas."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any,
        option: str | None = None,
    ) -> None:  # fmt: skip
        names = [name.strip() for name in values.split(",")]
        unknown = [name for name in names if name not in ITEMS]
        if unknown:
            asked = ", ".join(map(repr, unknown))
            raise argparse.ArgumentError(self, f"{asked}: items are {', '.join(ITEMS)}")
        setattr(namespace, self.dest, [*(getattr(namespace, self.dest) or []), *names])


def _minutes(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"must be a number, not negative, got {text!r}")
    return value


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
