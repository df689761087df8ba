"""Compute items one after the other with a bar of progress, and write the report after each."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import click

import cg
from cg.support.parallel import has_bars, make_bar
from cg.support.parsing import write_file

from .blocks import Context, Data, Item, Progress, Settings
from .report import page, section

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


FORMAT = "reproduce-paper 2"


def check_output(out: Path) -> None:
    """Create the output folder; BadParameter unless files can be written there."""
    try:
        for folder in (out, out / "figures", out / "checkpoints"):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
    except (FileExistsError, NotADirectoryError):
        raise click.BadParameter(f"{out} is not a directory", param_hint="--out") from None
    except OSError as error:
        problem = f"{out} is not writable: {error.strerror}"
        raise click.BadParameter(problem, param_hint="--out") from None


def run(
    items: Sequence[Item],
    out: Path,
    settings: Settings,
    workers: int,
    display: Display | None = None,
) -> dict[str, Any]:
    """Compute items; write ``results.json``, figures and ``report.html`` as each finishes.

    `items` are in the order of computation, with all that they need. Returns the content of
    ``results.json``: ``format``, ``settings``, ``items`` with the data of each by name, and
    ``run``, what differs between equal runs: ``seconds`` of items, ``workers`` and ``version``.
    """
    results: dict[str, Data] = {}
    seconds: dict[str, float] = {}
    sections: dict[str, str] = {}
    state = {
        "format": FORMAT,
        "settings": vars(settings),
        "items": results,
        "run": {"seconds": seconds, "workers": workers, "version": cg.__version__},
    }
    for item in items:
        begun = time.perf_counter()
        progress = Context.progress if display is None else display.begin(item)
        context = Context(settings, out / "checkpoints", workers, progress, results)
        # as JSON restores them, so that new and stored data are equal
        results[item.name] = json.loads(json.dumps(item.compute(context), allow_nan=False))
        seconds[item.name] = round(time.perf_counter() - begun, 2)
        sections[item.name] = section(item, results[item.name], out)
        text = json.dumps(state, indent=1, ensure_ascii=False, allow_nan=False)
        write_file(out / "results.json", f"{text}\n")
        write_file(out / "report.html", page(state, sections))
        if display is not None:
            display.finish(item, seconds[item.name])
    return state
