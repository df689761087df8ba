"""Representations of methods in notebooks."""

from html import escape
from itertools import islice

from cg.construction.formats.latex import short_numbers, to_array
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.method import Method
from cg.support.parsing import visible

_MAX_ROWS = 40
_CELL = 'style="text-align: right; padding: 0.1em 0.6em'
_LEFT = f'{_CELL}; border-right: 1px solid"'
_TEXT = 'class="tex2jax_ignore mathjax_ignore"'  # MathJax leaves dollar signs alone
_LINE = 'style="border-top: 1px solid"'


def to_formula(method: Method) -> str:
    """Return a method as a LaTeX formula with few digits, in ``$`` signs."""
    return f"$\\displaystyle {to_array(method)}$"


def to_html(method: Method) -> str:
    """Return a method as HTML: a summary, and its tableau or points with few digits."""
    title = (
        f"<b>{escape(visible(method.name) or 'without name')}</b>: {escape(method.description())}"
    )
    table = _points(method) if isinstance(method, CommutatorFree) else _tableau(method)
    source = f"<br><small>{escape(visible(method.source))}</small>" if method.source else ""
    return f"<div {_TEXT}>{title}{source}\n{table}\n</div>"


def _tableau(method: Method) -> str:
    rows = []
    for i, (first, *entries) in enumerate(islice(short_numbers(method), _MAX_ROWS)):
        cells = "".join(f'<td {_CELL}">{entry}</td>' for entry in entries)
        line = f" {_LINE}" if i == method.stages else ""
        rows.append(f"<tr{line}><td {_LEFT}>{first}</td>{cells}</tr>")
    third = getattr(method, "third_weights", None) is not None
    return _table("", rows, method.stages + 1 + method.layout.pair + third)


def _points(method: CommutatorFree) -> str:
    roles = method.tree.roles()
    rows = [_row("0", "", "", roles.get(-1, []))]
    shown = islice(zip(method.points, short_numbers(method), strict=True), _MAX_ROWS - 1)
    for m, (point, numbers) in enumerate(shown):
        terms = " + ".join(
            f"{short} F<sub>{stage + 1}</sub>"
            for stage, short in zip(point.weights, numbers, strict=True)
        )
        rows.append(_row(str(m + 1), str(point.parent + 1), terms, roles.get(m, [])))
    return _table(
        "<tr><th>point</th><th>from</th><th>along h times</th><th></th></tr>",
        rows,
        1 + len(method.points),
    )


def _row(point: str, origin: str, terms: str, roles: list[str]) -> str:
    cells = f'<td {_CELL}">{point}</td><td {_CELL}">{origin}</td>'
    left = _CELL.replace("right", "left")
    return f'<tr>{cells}<td {left}">{terms}</td><td {left}">{", ".join(roles)}</td></tr>'


def _table(head: str, rows: list[str], all_rows: int) -> str:
    if left := all_rows - len(rows):
        rows = [*rows, f'<tr><td colspan="4">and {left} more</td></tr>']
    return "<table>" + head + "\n".join(rows) + "</table>"
