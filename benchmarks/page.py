"""The page with the results, and the file with their numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

from reproduce.markdown import table

from .record import Result, Row

Environments = Mapping[str, Mapping[str, str]]
"""For each benchmark the processor and the versions of software that it ran with."""

_INTRODUCTION = """\
# Benchmarks

`make benchmarks` repeats all measurements and writes this page and `benchmarks/results.json`. Each
ratio compares two computations of the same quantity that ran in turns in one process on one core.
Times are processor times, and ratios are medians over the rounds. So ratios are meaningful on other
machines, absolute times less so."""


def read(file: Path) -> tuple[dict[str, Result], dict[str, dict[str, str]]]:
    """Return the stored results and their environments by name, none if there is no file."""
    if not file.exists():
        return {}, {}
    stored = json.loads(file.read_text(encoding="utf-8"))
    results = {name: Result.from_data(data["result"]) for name, data in stored.items()}
    return results, {name: data["environment"] for name, data in stored.items()}


def write(results: Mapping[str, Result], environments: Environments, file: Path) -> None:
    """Store results and their environments, one line each."""
    lines = [
        f"{json.dumps(name)}: " + json.dumps(
            {"environment": environments[name], "result": result.data()},
            ensure_ascii=False, allow_nan=False,
        )
        for name, result in results.items()
    ]  # fmt: skip
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def render(results: Mapping[str, Result], environments: Environments) -> str:
    """Return the page in Markdown, which ends with a list of the environments."""
    facts = {
        name: ", ".join(f"{key} {value}" for key, value in environments[name].items())
        for name in results
    }
    numbers = {text: k for k, text in enumerate(dict.fromkeys(facts.values()), 1)}
    parts = [_INTRODUCTION]
    for name, result in results.items():
        command = f"`python -m benchmarks {name}`, environment {numbers[facts[name]]}."
        parts += [f"## {result.title}", f"{command} {result.method}"]
        parts += [_table(result.rows)] if result.rows else []
        parts += result.notes
    parts.append("## Environments")
    parts.append("\n".join(f"{number}. {text}" for text, number in numbers.items()))
    return "\n\n".join(parts) + "\n"


def _table(rows: tuple[Row, ...]) -> str:
    return table(("", "here", "compared with", "there", "ratio"), list(map(_cells, rows)))


def _cells(row: Row) -> tuple[str, ...]:
    other = "" if row.other is None else f"{_number(row.other)} {row.unit}"
    ratio = "" if row.ratio is None else _number(row.ratio)
    if row.spread is not None:
        ratio += " ({} to {})".format(*map(_number, row.spread))
    return row.quantity, f"{_number(row.value)} {row.unit}", row.against, other, ratio


def _number(value: float) -> str:
    if value == 0:
        return "0"
    if abs(value) >= 1e5 or abs(value) < 1e-3:
        return f"{value:.1e}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"
