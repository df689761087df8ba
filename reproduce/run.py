"""Compute items one after the other, and write the report after each."""

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cg
from cg.support.parsing import write_file

from . import fingerprint
from .blocks import Data
from .context import Context, Item, Settings
from .display import Display
from .items import ITEMS
from .report import page, section

FORMAT = "reproduce-paper 2"

_RESULTS = "results.json"
_REPORT = "report.html"


class OutputError(Exception):
    """The output folder cannot be used; the message gives the reason."""


def check_output(out: Path) -> None:
    """Create the output folder; OutputError unless files can be written there."""
    try:
        for folder in (out, out / "figures", out / "checkpoints"):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
    except (FileExistsError, NotADirectoryError):
        raise OutputError(f"{out} is not a directory") from None
    except OSError as error:
        raise OutputError(f"{out} is not writable: {error.strerror}") from None


def check_settings(out: Path, settings: Settings) -> None:
    """Raise OutputError if a report with other settings would be overwritten."""
    try:
        stored = Settings(**_read(out)["settings"])
    except (OSError, ValueError, KeyError, TypeError):
        return  # there is no report
    if stored != settings:
        raise OutputError(
            f"{out} holds a report of other settings ({stored}; now {settings}), which would be "
            "replaced; give another folder"
        )


def run(
    items: Sequence[Item],
    out: Path,
    settings: Settings,
    workers: int,
    display: Display | None = None,
    limit: float | None = None,
) -> dict[str, Any]:
    """Compute items; write ``results.json``, figures and ``report.html`` as each finishes.

    `items` are in the order of computation, with all that they need; `limit` are the seconds that
    each search may take. Items that an earlier run of the same version, with the same settings,
    left in the folder `out` stay in the report, except those that need an item whose data have
    changed. Long items are shown as partial while they run. Returns the content of
    ``results.json``: ``format``, ``settings``, ``items`` with the data of each by name, and
    ``run``, what differs between equal runs: ``seconds`` of items, ``workers``, ``version`` and a
    digest of the ``code``.
    """
    state = _earlier(out, settings)
    state["run"]["workers"] = workers
    results: dict[str, Data] = state["items"]
    sections = {name: section(ITEMS[name], numbers, out) for name, numbers in results.items()}

    def show(item: Item, numbers: Data, begun: float) -> None:
        numbers = _as_json(numbers)
        if results.get(item.name) != numbers:
            for name in _needing(item.name):
                results.pop(name, None)
                sections.pop(name, None)
        results[item.name] = numbers
        state["items"] = {name: results[name] for name in ITEMS if name in results}
        state["run"]["seconds"][item.name] = round(time.perf_counter() - begun, 2)
        sections[item.name] = section(item, numbers, out)
        write_file(
            out / _RESULTS, json.dumps(state, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        )
        write_file(out / _REPORT, page(state, sections))

    for item in items:
        begun = time.perf_counter()
        publish = partial(show, item, begun=begun)
        context = Context(
            settings, out / "checkpoints", workers, publish=publish, limit=limit, results=results
        )
        if display is not None:
            context = replace(context, progress=display.begin(item))
        publish(item.compute(context))
        if display is not None:
            display.finish(item, time.perf_counter() - begun)
    return state


def _needing(name: str) -> set[str]:
    """Return the items that need an item, directly or through others."""
    direct = {item.name for item in ITEMS.values() if name in item.needs}
    return direct.union(*map(_needing, direct))


def _earlier(out: Path, settings: Settings) -> dict[str, Any]:
    """Return the state of an equal run from the folder, or a new state."""
    fresh = {
        "format": FORMAT,
        "settings": {"seed": settings.seed, "full": settings.full},
        "items": {},
        "run": {"seconds": {}, "version": cg.__version__, "code": fingerprint.digest()},
    }
    try:
        state = _read(out)
        same = all(state[key] == fresh[key] for key in ("format", "settings"))
        if same and state["run"]["code"] == fresh["run"]["code"]:  # type: ignore[index]
            return state
    except (OSError, ValueError, KeyError, TypeError):
        pass  # there is no usable state
    return fresh


def _read(out: Path) -> dict[str, Any]:
    state: dict[str, Any] = json.loads((out / _RESULTS).read_text(encoding="utf-8"))
    return state


def _as_json(numbers: Data) -> Data:
    """Return the data as JSON restores them, so that new and stored data are equal."""
    data: Data = json.loads(json.dumps(numbers, allow_nan=False))
    return data
