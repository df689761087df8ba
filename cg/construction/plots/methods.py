"""Plots of tableaux, of trees of points, and of ordered trees."""

from collections.abc import Mapping
from fractions import Fraction
from itertools import count
from typing import Any

from cg.construction.catalogue import resolve_method
from cg.construction.layouts.points import START, PointTree
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.trees.ordered import OrderedTree
from cg.plot.style import COLOURS, FAINT, axes_for, blank, verbatim
from cg.support.quads import to_decimal

_MAX_TERMS = 12  # terms of all flows together; with more, the weights of flows aren't written
_SIZE, _MIN_SIZE = 10.0, 7.0  # sizes of the font of tableaux
_RISE = 0.3  # height of the first child above its parent; another branch is 1 above

_MAX_NODES = 200


def tableau(method: str | Method, ax: Any = None) -> Any:
    """Draw the tableau of a method: abscissae, a, b and the second weights of a pair.

    The tableau of a commutator-free method is the classical one, with the sums of the weights of
    the flows to each stage. Coefficients that aren't short fractions have four digits.

    Parameters
    ----------
    method

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> ax = cg.plot.tableau("CG3")
    >>> sorted({text.get_text() for text in ax.texts})[:4]
    ['0', '119/216', '13/51', '17/108']
    """
    method = no_splitting(resolve_method(method))
    given, ax = ax, axes_for(ax)
    s = method.stages
    a, b = method.exact
    rows = [*a, b]
    if method.exact_embedded is not None:
        rows.append(method.exact_embedded)
    for i, row in enumerate(rows):
        y = -i - 0.5 * (i >= s)
        if i < s:
            ax.text(0.0, y, _text(method.abscissae[i]), **_cell(FAINT))
        for j, entry in enumerate(row, 1):
            if entry or (i >= s):
                ax.text(j, y, _text(entry), **_cell("black"))
    ax.plot([0.5, 0.5], [0.5, -len(rows) - 0.1], "-", color="black", linewidth=0.8)
    ax.plot([-0.5, s + 0.5], [-s + 0.25] * 2, "-", color="black", linewidth=0.8)
    blank(ax)
    ax.set_xlim(-0.6, s + 0.6)
    ax.set_ylim(-len(rows) - 0.2, 0.6)
    _set_title(ax, method)
    _fit_cells(ax, widen=given is None)
    return ax


def no_splitting(method: Method) -> Method:
    """Return a method; ValueError if it is a splitting method, which has kicks and drifts."""
    if isinstance(method, Splitting):
        raise ValueError(f"method must be no splitting method, got {method!r}")
    return method


def _fit_cells(ax: Any, *, widen: bool) -> None:
    """Reduce the font size so that no text is wider than a cell of width 1, or widen the figure."""
    ax.figure.draw_without_rendering()
    texts = [(text, text.get_window_extent().width) for text in ax.texts]
    left, right = ax.get_xlim()
    cell = 0.9 * ax.get_window_extent().width / (right - left)
    size = _SIZE * min(1.0, cell / max(width for _, width in texts))
    if widen and size < _MIN_SIZE:
        ax.figure.set_figwidth(ax.figure.get_figwidth() * _MIN_SIZE / size)
        size = _MIN_SIZE
    for text, _ in texts:
        text.set_fontsize(size)


def _set_title(ax: Any, method: Method) -> None:
    ax.set_title(f"{verbatim(method.name) or 'without name'}: {method.description()}", fontsize=10)


def _cell(colour: str) -> dict[str, Any]:
    return {"ha": "center", "va": "center", "fontsize": _SIZE, "color": colour}


def _text(value: Fraction, digits: int = 4) -> str:
    text = str(value) if len(str(value)) <= digits + 3 else to_decimal(value, digits)
    return text.replace("-", "−")


def _flow(weights: Mapping[int, Fraction]) -> str:
    """Return the sum of fields of a flow as text, two terms a line."""
    terms = [f"{_text(weight, 3)} F{k + 1}" for k, weight in weights.items()]
    signed = [terms[0], *(f"− {x[1:]}" if x.startswith("−") else f"+ {x}" for x in terms[1:])]
    return "\n".join(" ".join(signed[k : k + 2]) for k in range(0, len(signed), 2))


def points(method: str | Method, ax: Any = None) -> Any:
    """Draw the points of a step at their times; each line is a flow.

    Stages are numbered circles, the result is a square and the second result a diamond. The
    weights of each flow are written on its line if there are at most twelve.

    Parameters
    ----------
    method
        An explicit method.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> ax = cg.plot.points("CF4")
    >>> ax.get_title()
    'CF4: order 4, 4 evaluations, 5 flows'
    """
    method = no_splitting(resolve_method(method))
    if not method.explicit:
        raise ValueError(f"method must be explicit, got {method!r}")
    ax = axes_for(ax)
    tree = method.tree.without_repetitions()
    places = _places(tree)
    used = [m for m in places if m != START]
    labelled = sum(len(tree.points[m].weights) for m in used) <= _MAX_TERMS
    for m in used:
        xs, ys = zip(places[tree.points[m].parent], places[m], strict=True)
        ax.plot(xs, ys, "-", color=FAINT, linewidth=1.2, zorder=1)
        if labelled:
            ax.text(
                (xs[0] + xs[1]) / 2,
                (ys[0] + ys[1]) / 2,
                _flow(tree.points[m].weights),
                ha="center",
                va="center",
                fontsize=7,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            )
    _draw_points(ax, tree, places)
    ax.set_xlabel("time of the point, in steps")
    ax.set_yticks([])
    for side in ("left", "right", "top"):
        ax.spines[side].set_visible(False)
    ax.margins(0.1, 0.15)
    _set_title(ax, method)
    return ax


def _draw_points(ax: Any, tree: PointTree, places: dict[int, tuple[float, float]]) -> None:
    others = [place for m, place in places.items() if m != START]
    ax.scatter(*zip(*others, strict=True), s=12, color=FAINT, zorder=2)
    looks = ("s", COLOURS[1], "result"), ("D", COLOURS[2], "second result")
    for end, (marker, colour, label) in zip(tree.results, looks, strict=False):
        ax.scatter(*places[end], s=230, marker=marker, color=colour, zorder=3, label=label)
    stages: dict[int, list[str]] = {}
    for k, at in enumerate(tree.stage_points, 1):
        stages.setdefault(at, []).append(str(k))
    for number, (at, numbers) in enumerate(stages.items()):
        once = {"label": "stages"} if number == 0 else {}
        ax.scatter(*places[at], s=130, color=COLOURS[0], zorder=4, **once)
        ax.text(
            *places[at],
            ", ".join(numbers),
            color="white",
            ha="center",
            va="center",
            fontsize=7,
            fontweight="bold",
            zorder=5,
        )
    ax.legend(frameon=False, fontsize=8, markerscale=0.5, loc="upper left")


def _places(tree: PointTree) -> dict[int, tuple[float, float]]:
    """Return the places of the points: x is the time, and each branch has another height."""
    ends = *tree.stage_points, *tree.results
    used = sorted({m for end in ends for m in tree.path(end)})
    children: dict[int, list[int]] = {m: [] for m in (START, *used)}
    for m in used:
        children[tree.points[m].parent].append(m)
    times = {START: 0.0}
    for m in used:
        point = tree.points[m]
        times[m] = times[point.parent] + float(sum(point.weights.values(), Fraction(0)))
    heights: dict[int, float] = {}
    pending = [(START, START, True)]
    while pending:  # depth first, each branch above the previous ones
        m, parent, first = pending.pop()
        if m == START:
            heights[m] = 0.0
        else:
            heights[m] = heights[parent] + _RISE if first else max(heights.values()) + 1.0
        pending += [(child, m, k == 0) for k, child in reversed(list(enumerate(children[m])))]
    return {m: (times[m], heights[m]) for m in (START, *used)}


def tree(tree: OrderedTree | str, ax: Any = None) -> Any:
    """Draw an ordered tree with its root at the bottom and children from left to right.

    Its bracket notation and its density γ are written below.

    Parameters
    ----------
    tree
        A tree, or its bracket notation; at most 200 nodes.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> ax = cg.plot.tree("[[][[]]]")
    >>> ax.get_xlabel()
    '[[][[]]]   γ = 3'
    """
    if isinstance(tree, str):
        tree = OrderedTree.parse(tree)
    if not isinstance(tree, OrderedTree):
        raise TypeError(f"tree must be an OrderedTree or its text, got {tree!r}")
    if tree.nodes > _MAX_NODES:
        raise ValueError(f"tree must have at most {_MAX_NODES} nodes, got {tree.nodes}")
    ax = axes_for(ax)
    nodes, edges = layout(tree)
    for parent, child in edges:
        xs, ys = zip(nodes[parent], nodes[child], strict=True)
        ax.plot(xs, ys, "-", color="black", linewidth=1.2, zorder=1)
    xs, ys = zip(*nodes, strict=True)
    ax.scatter(xs, ys, s=45, color=COLOURS[0], zorder=2)
    ax.scatter(xs[:1], ys[:1], s=60, color=COLOURS[1], zorder=3)  # the root
    blank(ax)
    ax.set_aspect("equal", anchor="S")
    ax.set_xlim(min(xs) - 0.6, max(xs) + 0.6)
    ax.set_ylim(-0.4, max(ys) + 0.4)
    ax.set_xlabel(f"{tree}   γ = {tree.density}")
    return ax


def layout(tree: OrderedTree) -> tuple[list[tuple[float, float]], list[tuple[int, int]]]:
    """Return the places of nodes, root first, leaves one apart, and edges (parent, child)."""
    places: list[tuple[float, float]] = []
    edges: list[tuple[int, int]] = []
    leaves = count()

    def place(node: OrderedTree, height: float) -> int:
        number = len(places)
        places.append((0.0, height))
        below = [place(child, height + 1.0) for child in node.children]
        edges.extend((number, child) for child in below)
        x = (places[below[0]][0] + places[below[-1]][0]) / 2 if below else float(next(leaves))
        places[number] = x, height
        return number

    place(tree, 0.0)
    return [(x - places[0][0], height) for x, height in places], edges
