"""The page of results, and the file of numbers behind it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

from .record import Aim, Result, Row

__all__ = ["read", "read_environments", "render", "write"]

_INTRODUCTION = """\
# Benchmarks

`make benchmarks` measures all of this again and rewrites this page and
`benchmarks/results.json`. Every ratio is between two ways to compute the same in the same
process, in turns, on one core; times are those of the processor, and ratios medians over the
rounds. So a ratio means something on a busy or another machine, a time alone less."""


def read(file: Path) -> dict[str, Result]:
    """Return the results stored in a file, by name; none if there is no such file."""
    if not file.exists():
        return {}
    stored = json.loads(file.read_text(encoding="utf-8"))
    return {name: Result.from_data(data) for name, data in stored["results"].items()}


def read_environments(file: Path) -> dict[str, dict[str, str]]:
    """Return what each of the stored results was measured with, by its name."""
    if not file.exists():
        return {}
    stored = json.loads(file.read_text(encoding="utf-8"))
    return {name: dict(found) for name, found in stored["environments"].items()}


def write(
    results: Mapping[str, Result], environments: Mapping[str, Mapping[str, str]], file: Path
) -> None:
    """Store results and what each depends on."""
    content = {
        "environments": {name: dict(environments[name]) for name in results},
        "results": {name: result.data() for name, result in results.items()},
    }
    file.write_text(
        json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
    )


def render(results: Mapping[str, Result], environments: Mapping[str, Mapping[str, str]]) -> str:
    """Return the page in Markdown; results of one environment follow what it was."""
    parts = [_INTRODUCTION]
    several = len({tuple(environments[name].items()) for name in results}) > 1
    for number, (name, result) in enumerate(results.items()):
        facts = ", ".join(f"{key} {value}" for key, value in environments[name].items())
        if number == 0 and not several:
            parts.append(f"Measured with: {facts}.")
        parts += [f"## {result.title}", f"`python -m benchmarks {name}`. {result.method}"]
        if several:
            parts.append(f"Measured with: {facts}.")
        if result.rows:
            parts.append(_table(result.rows))
        parts += result.notes
        parts += [f"![{x.caption}]({x.name}.png)\n\n*{x.caption}*" for x in result.figures]
    return "\n\n".join(parts) + "\n"


def _table(rows: tuple[Row, ...]) -> str:
    lines = ["| | here | compared with | there | ratio | aim |", "|---|---|---|---|---|---|"]
    for row in rows:
        other = "none found" if row.ratio_is_bound else ""
        if row.other is not None:
            other = f"{_number(row.other)} {row.unit}"
        ratio = "" if row.ratio is None else ("> " * row.ratio_is_bound + _number(row.ratio))
        here = "none found" if math.isnan(row.value) else f"{_number(row.value)} {row.unit}"
        cells = (row.quantity, here, row.against, other, ratio)
        lines.append(f"| {' | '.join((*cells, _aim(row.aim, row.met)))} |")
    return "\n".join(lines)


def _aim(aim: Aim | None, met: bool | None) -> str:
    if aim is None:
        return ""
    sign = "≥" if aim.above else "≤"
    return f"{aim.of} {sign} {_number(aim.bound)}: {'met' if met else '**missed**'}"


def _number(value: float) -> str:
    if value == 0:
        return "0"
    if abs(value) >= 1e5 or abs(value) < 1e-3:
        return f"{value:.1e}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"
