"""The report, one self-contained page, of the items in ``ITEMS`` of each module in ``sections``."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

from . import sections
from .blocks import Block, Chart, Data, Item, Table, Text
from .style import render

_NAMES = [
    f"{sections.__name__}.{module.name}" for module in pkgutil.iter_modules(sections.__path__)
]
_ITEMS: list[Item] = [item for name in _NAMES for item in import_module(name).ITEMS]

ITEMS = {item.name: item for item in sorted(_ITEMS, key=lambda item: item.turn)}
"""All items by name in the order of computation: those of the paper and quick ones first."""


def select(names: Iterable[str]) -> list[Item]:
    """Return items and all items that they need, in the order of computation.

    KeyError if there is no item with a given name.
    """
    selected: set[str] = set()
    pending = list(names)
    while pending:
        name = pending.pop()
        if name not in selected:
            selected.add(name)
            pending.extend(ITEMS[name].needs)
    return [item for item in ITEMS.values() if item.name in selected]


_TITLE = "Runge–Kutta methods of Crouch–Grossman type of high order, reproduced"
_MARKS = {"pass": "✓", "fail": "✗", "not reproducible": "–"}


def page(state: Mapping[str, Any], sections: Mapping[str, str]) -> str:
    """Return the whole page, from the content of ``results.json`` and the sections by item."""
    by_place = sorted(ITEMS.values(), key=lambda item: item.place)
    shown = [item for item in by_place if item.name in sections]
    links = "".join(f'<li><a href="#{_id(item)}">{escape(item.title)}</a></li>' for item in shown)
    settings, run = state["settings"], state["run"]
    extent = "extensive search" if settings["full"] else "default search"
    times = ", ".join(f"{item.title}: {run['seconds'][item.name]:.1f} s" for item in shown)
    css = files(__package__).joinpath("report.css").read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(_TITLE)}</title>
<style>
{css}</style>
</head>
<body>
<header>
<h1>{escape(_TITLE)}</h1>
<p>After Z. Jackiewicz, A. Marthinsen and B. Owren, “Construction of Runge–Kutta methods of
Crouch–Grossman type of high order”, Advances in Computational Mathematics 13 (2000), 405–415.
All numbers of ours on this page were computed by reproduce-paper, except the radii of
certificates, which are read from their files; results.json has all of them.</p>
<p>Seed {settings["seed"]}, {extent}, version {escape(run["version"])}.</p>
<nav aria-label="Contents"><ol>{links}</ol></nav>
</header>
<main>
{"".join(sections[item.name] for item in shown)}</main>
<footer><p>Time by item, {run["workers"]} threads. {escape(times)}.</p></footer>
</body>
</html>
"""


def section(item: Item, numbers: Data, out: Path) -> str:
    """Return the section of an item, and draw its figures into ``out/figures``."""
    body = "".join(_block(block, out) for block in item.present(numbers))
    name = _id(item)
    return (
        f'<section id="{name}" aria-labelledby="{name}-title">\n'
        f'<h2 id="{name}-title">{escape(item.title)}</h2>\n{body}</section>\n'
    )


def _id(item: Item) -> str:
    return "item-" + item.name.replace(".", "-")


def _block(block: Block, out: Path) -> str:
    match block:
        case Text(text):
            return f"<p>{escape(text)}</p>\n"
        case Table():
            return _table(block)
        case Chart():
            return _chart(block, out)


def _chart(chart: Chart, out: Path) -> str:
    svg = render(chart, out / "figures")
    name = chart.name.replace(".", "-")
    return (
        f'<figure>\n<div class="wide" tabindex="0">{svg}</div>\n<figcaption>{escape(chart.caption)}'
        f'<span class="description" id="{name}-description">{escape(chart.description)}</span>'
        f"</figcaption>\n</figure>\n"
    )


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in table.header)
    rows = "".join("<tr>" + _row(table.header, row) + "</tr>\n" for row in table.rows)
    kind = ' class="numeric"' if table.numeric else ' class="words"'
    inner = f"<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}</tbody>\n"
    caption = escape(table.caption)
    if table.folded:
        return (
            f"<details><summary>{caption}</summary>"
            f'<div class="wide"><table{kind} aria-label="{caption}">\n{inner}</table></div>'
            "</details>\n"
        )
    return f'<div class="wide"><table{kind}>\n<caption>{caption}</caption>\n{inner}</table></div>\n'


def _row(header: Sequence[str], cells: Sequence[str]) -> str:
    first, *rest = cells
    inner = "".join(_cell(name, text) for name, text in zip(header[1:], rest, strict=True))
    return f'<th scope="row">{escape(first)}</th>{inner}'


def _cell(column: str, text: str) -> str:
    """Return a cell; on narrow screens the name of its column is shown before it."""
    label = f'data-column="{escape(column)}"'
    if text in _MARKS:
        name = text.replace(" ", "-")
        mark = f'<span aria-hidden="true">{_MARKS[text]}</span>'
        return f'<td {label} class="verdict {name}">{mark} {text}</td>'
    return f"<td {label}>{escape(text)}</td>"
