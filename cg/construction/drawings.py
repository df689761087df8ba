"""Methods and trees as text for terminals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import chain, zip_longest
from typing import Any

from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.points import START, points_of
from cg.construction.trees import OrderedTree
from cg.support.checks import check_instance, check_integer
from cg.support.quads import MAX_WRITTEN, to_decimal

_NODE = "●"
_DIGITS = 6  # digits of coefficients
_MAX_DENOMINATOR_BITS = 128  # largest denominator; longer fractions are shown as decimals


def align_columns(rows: Sequence[Sequence[str]], *, left: int = 2) -> str:
    """Return rows, also short ones, as aligned columns of text, the first `left` flush left."""
    widths = [max(map(len, column)) for column in zip_longest(*rows, fillvalue="")]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=False))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def draw_method(method: Method) -> str:
    """Return the coefficients of a method as text: points as a tree, others in columns."""
    if isinstance(method, CommutatorFree):
        return f"{draw_points(method)}\n\nwhere flows commute:\n{_tableau(method)}"
    if isinstance(method, MagnusMethod):
        rows = {
            "nodes": [method.nodes],
            "bracket of": chain(*method.brackets),
            "flow": method.weights,
            "flow of the second result": method.embedded_weights or (),
            "flow of the third": filter(None, [method.third_weights]),
        }
        return align_columns([
            [label, "│", *(_number(x.value) for x in row)]
            for label, block in rows.items()
            for row in block
        ])  # fmt: skip
    if isinstance(method, Splitting):
        numbers = [_number(x.value) for x in method.coefficients]
        pairs = [numbers[k : k + 2] for k in range(0, len(numbers), 2)]
        return align_columns([["drift", "kick"], *pairs], left=0)
    return _tableau(method)


def _tableau(method: Method) -> str:
    """Return c, a and b of the flat tableau in columns; ``b^`` stands before second weights."""
    a, b = method.exact
    rows: list[Any] = [(c, *row) for c, row in zip(method.abscissae, a, strict=True)]
    if method.explicit:
        rows = [row[: end + 1] for end, row in enumerate(rows)]
    rows += [("b", *b), *([("b^", *method.exact_embedded)] if method.exact_embedded else [])]
    lines = [[x if isinstance(x, str) else _number(x) for x in row] for row in rows]
    text = align_columns([[c, "│", *weights] for c, *weights in lines]).splitlines()
    rule = "─" * max(map(len, text))
    return "\n".join([*text[: method.stages], rule, *text[method.stages :]])


def _number(x: Fraction) -> str:
    # Python may be unable to write a longer fraction
    text = str(x) if x.denominator.bit_length() <= _MAX_DENOMINATOR_BITS else ""
    return text if 0 < len(text) <= _DIGITS + 1 else to_decimal(x, _DIGITS)


def draw_tree(tree: OrderedTree) -> str:
    """Return an ordered tree as lines of text, each node above its children."""
    check_instance("tree", tree, OrderedTree)
    return _draw(tree, lambda node: node.children, lambda _: _NODE)


def draw_points(method: Any, *, digits: int = _DIGITS) -> str:
    """Return the points of an explicit method as text, one flow a line, each above its children.

    >>> import crouch_grossman as cg
    >>> print(draw_points(cg.methods["CF3"]))
    start: stage 1
    ├── point 1: 0.333333 F1; stage 2
    │   └── point 3: -0.0833333 F1 + 0.75 F3; result
    └── point 2: 0.666667 F2; stage 3
    """
    tree, digits = points_of(method), check_integer("digits", digits, 1, MAX_WRITTEN)
    below: dict[int, list[int]] = {m: [] for m in range(START, len(tree.points))}
    for m, point in enumerate(tree.points):
        below[point.parent].append(m)
    roles = tree.roles()

    def label(m: int) -> str:
        if m == START:
            return f"start: {', '.join(roles[m])}" if m in roles else "start"
        terms = [(to_decimal(w, digits), k + 1) for k, w in tree.points[m].weights.items()]
        flow = " + ".join(f"{weight} F{stage}" for weight, stage in terms).replace("+ -", "- ")
        return "; ".join([f"point {m + 1}: {flow or 'no flow'}", *roles.get(m, [])])

    return _draw(START, below.__getitem__, label)


def _draw(root: Any, children: Callable[[Any], Sequence[Any]], label: Callable[[Any], str]) -> str:
    lines = []
    pending = [(root, "", "")]
    while pending:
        node, lead, indent = pending.pop()
        lines.append(lead + label(node))
        branch, gap = "└── ", "    "  # those of the last child
        for child in reversed(children(node)):
            pending.append((child, indent + branch, indent + gap))
            branch, gap = "├── ", "│   "
    return "\n".join(lines)
