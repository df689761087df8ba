"""The page of results, and the file of numbers behind it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

from .record import Aim, Result, Row

__all__ = ["read", "render", "write"]

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


def write(results: Mapping[str, Result], environment: Mapping[str, str], file: Path) -> None:
    """Store results and what they depend on."""
    content = {
        "environment": dict(environment),
        "results": {name: result.data() for name, result in results.items()},
    }
    file.write_text(
        json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
    )


def render(results: Mapping[str, Result], environment: Mapping[str, str]) -> str:
    """Return the page in Markdown."""
    facts = ", ".join(f"{name} {value}" for name, value in environment.items())
    parts = [_INTRODUCTION, f"Measured with: {facts}."]
    for name, result in results.items():
        parts += [f"## {result.title}", f"`python -m benchmarks {name}`. {result.method}"]
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
