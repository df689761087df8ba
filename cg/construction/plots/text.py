"""Trees and points of steps as text."""

from collections.abc import Callable, Sequence
from typing import Any

from cg.construction.layouts.points import START, points_of
from cg.construction.trees.ordered import OrderedTree
from cg.support.checks import check_integer
from cg.support.quads import MAX_WRITTEN, to_decimal

_NODE = "●"


def draw_tree(tree: OrderedTree) -> str:
    """Return an ordered tree as lines of text, each node above its children."""
    if not isinstance(tree, OrderedTree):
        raise TypeError(f"tree must be an OrderedTree, got {tree!r}")
    return _draw(tree, lambda node: node.children, lambda _: _NODE)


def draw_points(method: Any, *, digits: int = 6) -> str:
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
        below = list(children(node))
        for k in reversed(range(len(below))):
            last = k == len(below) - 1
            branch, gap = ("└── ", "    ") if last else ("├── ", "│   ")
            pending.append((below[k], indent + branch, indent + gap))
    return "\n".join(lines)
