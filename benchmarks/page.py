"""The pages with the results, and the file with their numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

from reproduce.markdown import table

from .record import Aim, Result, Row

Environments = Mapping[str, Mapping[str, str]]
"""For each benchmark the processor and the versions of software that it ran with."""

_INTRODUCTION = """\
# Benchmarks

`make benchmarks` repeats all measurements and writes this page and `benchmarks/results.json`. Each
ratio compares two computations of the same quantity that ran in turns in one process on one core.
Times are processor times, and ratios are medians over the rounds. So ratios are meaningful on other
machines, absolute times less so. Aims are bounds that were set before measuring; those that are
missed are in bold. [All tables](benchmark_tables.md) has more numbers."""

_INTRODUCTION_TO_DETAILS = """\
# Benchmarks: all tables

The numbers behind [Benchmarks](benchmarks.md)."""


def read(file: Path) -> dict[str, Result]:
    """Return the stored results by name, or an empty dict if the file does not exist."""
    if not file.exists():
        return {}
    stored = json.loads(file.read_text(encoding="utf-8"))
    return {name: Result.from_data(data) for name, data in stored["results"].items()}


def read_environments(file: Path) -> dict[str, dict[str, str]]:
    """Return the environments of the stored results by name."""
    if not file.exists():
        return {}
    stored = json.loads(file.read_text(encoding="utf-8"))
    return {name: dict(environment) for name, environment in stored["environments"].items()}


def write(results: Mapping[str, Result], environments: Environments, file: Path) -> None:
    """Store results and their environments."""
    content = {
        "environments": {name: dict(environments[name]) for name in results},
        "results": {name: result.data() for name, result in results.items()},
    }
    file.write_text(
        json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
    )


def write_pages(results: Mapping[str, Result], environments: Environments, folder: Path) -> None:
    """Write both pages into a folder."""
    pages = {
        "benchmarks.md": render(results, environments),
        "benchmark_tables.md": render_details(results),
    }
    for name, text in pages.items():
        (folder / name).write_text(text, encoding="utf-8")


def render(results: Mapping[str, Result], environments: Environments) -> str:
    """Return the main page in Markdown, which ends with a list of the environments."""
    facts = {
        name: ", ".join(f"{key} {value}" for key, value in environments[name].items())
        for name in results
    }
    numbers = {text: k for k, text in enumerate(dict.fromkeys(facts.values()), 1)}
    parts = [_INTRODUCTION]
    for name, result in results.items():
        command = f"`python -m benchmarks {name}`, environment {numbers[facts[name]]}."
        parts += [f"## {result.title}", f"{command} {result.method}", *_content(result)]
    parts.append("## Environments")
    parts.append("\n".join(f"{number}. {text}" for text, number in numbers.items()))
    return "\n\n".join(parts) + "\n"


def render_details(results: Mapping[str, Result]) -> str:
    """Return the page with all tables in Markdown."""
    parts = [_INTRODUCTION_TO_DETAILS]
    for details in (result.details for result in results.values()):
        if details is not None:
            parts += [f"## {details.title}", details.method, *_content(details)]
    return "\n\n".join(parts) + "\n"


def _content(result: Result) -> list[str]:
    table = [_table(result.rows)] if result.rows else []
    figures = [f"![{x.caption}]({x.name}.png)\n\n*{x.caption}*" for x in result.figures]
    return [*table, *result.notes, *figures]


def _table(rows: tuple[Row, ...]) -> str:
    """Return the table of some rows, without the columns that are empty in all of them."""
    heads = ("", "here", "compared with", "there", "ratio", "aim")
    lines = [_cells(row) for row in rows]
    columns = [k for k in range(len(heads)) if k < 2 or any(line[k] for line in lines)]
    return table([heads[k] for k in columns], [[line[k] for k in columns] for line in lines])


def _cells(row: Row) -> tuple[str, ...]:
    other = "none found" if row.ratio_is_bound else ""
    if row.other is not None:
        other = f"{_number(row.other)} {row.unit}"
    ratio = "" if row.ratio is None else ("> " * row.ratio_is_bound + _number(row.ratio))
    if row.spread is not None:
        ratio += " ({} to {})".format(*map(_number, row.spread))
    here = "none found" if math.isnan(row.value) else f"{_number(row.value)} {row.unit}".rstrip()
    return row.quantity, here, row.against, other, ratio, _aim(row.aim, row.met)


def _aim(aim: Aim | None, met: bool | None) -> str:
    if aim is None:
        return ""
    sign = "≥" if aim.above else "≤"
    return f"{aim.of} {sign} {aim.bound:g}: {'met' if met else '**missed**'}"


def _number(value: float) -> str:
    if value == 0:
        return "0"
    if abs(value) >= 1e5 or abs(value) < 1e-3:
        return f"{value:.1e}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"
