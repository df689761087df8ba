"""The command ``reproduce-paper``."""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click

from cg.command import main as run_command
from cg.runs import StoreError
from cg.support.parallel import available_cores

from .checkpoint import DamagedError
from .context import Settings
from .display import Display, duration
from .items import ITEMS, select
from .run import OutputError, check_output, check_settings, run

__all__ = ["main", "reproduce_command"]

_FOLDER = Path("reproduce/out")
_FULL_FOLDER = _FOLDER / "full"

_UNUSABLE = 2
_INTERRUPTED = 130


class _Items(click.ParamType):  # type: ignore[type-arg]
    """Names of items separated by commas."""

    name = "ITEM[,ITEM...]"

    def convert(
        self, value: str | list[str], param: click.Parameter | None, ctx: click.Context | None
    ) -> list[str]:
        if isinstance(value, list):
            return value
        names = [name.strip() for name in value.split(",")]
        if unknown := [name for name in names if name not in ITEMS]:
            texts = ", ".join(map(repr, unknown))
            self.fail(f"{texts}: items are {', '.join(ITEMS)}", param, ctx)
        return names


def _check_minutes(_: click.Context, __: click.Parameter, minutes: float | None) -> float | None:
    if minutes is not None and not 0.0 <= minutes < math.inf:
        raise click.BadParameter(f"must be finite and not negative, got {minutes:g}")
    return minutes


@click.command("reproduce", short_help="Reproduce the paper.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR",
    help="Folder for report.html, results.json, figures and checkpoints; by default "
    f"{_FOLDER}, with --full {_FULL_FOLDER}.",
)  # fmt: skip
@click.option(
    "--full", is_flag=True,
    help="The extensive search, with twenty times as many starts: hours.",
)  # fmt: skip
@click.option(
    "--minutes", type=float, callback=_check_minutes, metavar="M",
    help="End each search after M minutes; the report says how far it came, and the same command "
    "continues from there.",
)  # fmt: skip
@click.option(
    "--only", type=_Items(), multiple=True,
    help="Run these items and what they need; may be given several times.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of random starts."
)
@click.option(
    "--workers", type=click.IntRange(1), default=available_cores, metavar="N",
    help="Threads; all cores by default. The numbers do not depend on them.",
)  # fmt: skip
@click.option("--list", "show_items", is_flag=True, help="List the items and exit.")
def reproduce_command(
    out: Path | None,
    full: bool,
    minutes: float | None,
    only: tuple[list[str], ...],
    seed: int,
    workers: int,
    show_items: bool,
) -> int:
    r"""Reproduce the figures, tables and claims of the paper, and what goes beyond it.

    The result is one report. An interrupted run continues where it ended.

    \b
    Examples:
      crouch-grossman reproduce --list
      crouch-grossman reproduce --only fig4.1 --out report
    """
    if show_items:
        for item in ITEMS.values():
            click.echo(f"{item.name:16} {item.title}")
        return 0
    settings = Settings(seed, full)
    out = out or (_FULL_FOLDER if full else _FOLDER)
    try:
        check_output(out)
        check_settings(out, settings)
    except OutputError as error:
        return _complain(f"--out {error}")
    items = select([name for names in only for name in names] or ITEMS)
    limit = None if minutes is None else 60.0 * minutes
    display = Display(sys.stderr, items, full, limit)
    begun = time.perf_counter()
    try:
        with _terminated_as_interrupted():
            run(items, out, settings, workers, display.begin, display.finish, limit)
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command ``reproduce-paper``.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default those of the process.

    Returns
    -------
    int
        Exit status: 0; 2 if an argument is wrong, or the output folder cannot be used, is full or
        has a report with other settings; 130 after an interrupt.
    """
    return run_command(arguments, program="reproduce-paper", command=reproduce_command)


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
