"""Plots of methods and trees."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.catalogue import resolve_method
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.methods.stability import reason_without_limits, stability_function
from cg.construction.points import START, PointTree
from cg.construction.trees import OrderedTree
from cg.plot.style import COLOURS, FAINT, axes_for, blank, verbatim
from cg.support.quads import to_decimal

_MAX_TERMS = 12  # terms of all flows together; with more, the weights of flows aren't written
_SIZE, _FITTING = 10.0, 14.0  # largest size of the font of tableaux, and that for cells of an inch
_RISE = 0.3  # height of the first child above its parent; another branch is 1 above

_MAX_NODES = 200  # largest number of nodes of a tree that is drawn
_POINTS = 301  # points of a grid along each axis
_DASHES = ("solid", "dashed", "dashdot", "dotted")

Range = tuple[float, float]


def tableau(method: str | Method, ax: Any = None) -> Any:
    """Draw the tableau of a method: abscissae, a, b and the second weights of a pair.

    The tableau of a commutator-free method is the classical one, with the sums of the weights of
    the flows to each stage. Coefficients that aren't short fractions have four digits.

    Parameters
    ----------
    method
        A method of stages, or its name.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> ax = cg.plot.tableau("CG3")
    >>> sorted({text.get_text() for text in ax.texts})[:4]
    ['0', '119/216', '13/51', '17/108']
    """
    method = refuse_splitting(resolve_method(method))
    s = method.stages
    if ax is None:
        ax = axes_for(None)
        ax.figure.set_figwidth(max(ax.figure.get_figwidth(), 0.75 * s))
    inches = ax.get_window_extent().width / ax.figure.dpi
    size = min(_SIZE, _FITTING * inches / (s + 1.2))  # no text is wider than a cell of width 1
    a, b = method.exact
    rows = [*a, b, *filter(None, [method.exact_embedded])]
    for i, row in enumerate(rows):
        y = -i - 0.5 * (i >= s)
        if i < s:
            ax.text(0.0, y, _short_number(method.abscissae[i]), **_centred(FAINT, size))
        for j, entry in enumerate(row, 1):
            if entry or (i >= s):
                ax.text(j, y, _short_number(entry), **_centred(size=size))
    ax.plot([0.5, 0.5], [0.5, -len(rows) - 0.1], "-", color="black", linewidth=0.8)
    ax.plot([-0.5, s + 0.5], [-s + 0.25] * 2, "-", color="black", linewidth=0.8)
    blank(ax)
    ax.set_xlim(-0.6, s + 0.6)
    ax.set_ylim(-len(rows) - 0.2, 0.6)
    _set_title(ax, method)
    return ax


def refuse_splitting(method: Method) -> Method:
    """Return the method; raise ValueError for a splitting method, which has kicks and drifts."""
    if isinstance(method, Splitting):
        raise ValueError(f"method must be no splitting method, got {method!r}")
    return method


def _set_title(ax: Any, method: Method) -> None:
    ax.set_title(f"{verbatim(method.name) or 'without name'}: {method.description()}", fontsize=10)


def _centred(colour: str = "black", size: float = 7) -> dict[str, Any]:
    return {"ha": "center", "va": "center", "fontsize": size, "color": colour}


def _short_number(value: Fraction, digits: int = 4) -> str:
    text = str(value) if len(str(value)) <= digits + 3 else to_decimal(value, digits)
    return text.replace("-", "−")


def _flow(weights: Mapping[int, Fraction]) -> str:
    """Return the sum of fields of a flow as text, two terms a line."""
    terms = [f"{_short_number(weight, 3)} F{k + 1}" for k, weight in weights.items()]
    lines = [" + ".join(terms[k : k + 2]) for k in range(0, len(terms), 2)]
    return "\n+ ".join(lines).replace("+ −", "− ")


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
    method = refuse_splitting(resolve_method(method))
    if not method.explicit:
        raise ValueError(f"method must be explicit, got {method!r}")
    ax = axes_for(ax)
    tree = method.tree.without_repetitions()
    positions = _positions(tree)
    used = [m for m in positions if m != START]
    labelled = sum(len(tree.points[m].weights) for m in used) <= _MAX_TERMS
    for m in used:
        xs, ys = zip(positions[tree.points[m].parent], positions[m], strict=True)
        ax.plot(xs, ys, "-", color=FAINT, linewidth=1.2, zorder=1)
        if labelled:
            box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
            flow = _flow(tree.points[m].weights)
            ax.text(sum(xs) / 2, sum(ys) / 2, flow, bbox=box, **_centred())
    _draw_points(ax, tree, positions)
    ax.set_xlabel("time of the point, in steps")
    ax.set_yticks([])
    for side in ("left", "right", "top"):
        ax.spines[side].set_visible(False)
    ax.margins(0.1, 0.15)
    _set_title(ax, method)
    return ax


def _draw_points(ax: Any, tree: PointTree, positions: dict[int, tuple[float, float]]) -> None:
    others = [position for m, position in positions.items() if m != START]
    ax.scatter(*zip(*others, strict=True), s=12, color=FAINT, zorder=2)
    looks = ("s", COLOURS[1], "result"), ("D", COLOURS[2], "second result")
    for end, (marker, colour, label) in zip(tree.results, looks, strict=False):
        ax.scatter(*positions[end], s=230, marker=marker, color=colour, zorder=3, label=label)
    stages: dict[int, list[str]] = {}
    for k, point in enumerate(tree.stage_points, 1):
        stages.setdefault(point, []).append(str(k))
    for number, (point, numbers) in enumerate(stages.items()):
        once = {"label": "stages"} if number == 0 else {}
        ax.scatter(*positions[point], s=130, color=COLOURS[0], zorder=4, **once)
        text = ", ".join(numbers)
        ax.text(*positions[point], text, fontweight="bold", zorder=5, **_centred("white"))
    ax.legend(frameon=False, fontsize=8, markerscale=0.5, loc="upper left")


def _positions(tree: PointTree) -> dict[int, tuple[float, float]]:
    """Return the positions of the points: x is the time, and each branch has another height."""
    used = sorted({m for end in (*tree.stage_points, *tree.results) for m in tree.path(end)})
    positions: dict[int, tuple[float, float]] = {}

    def place(m: int, height: float) -> None:
        positions[m] = float(sum(tree.flat_row(m))), height
        for child in used:
            if tree.points[child].parent == m:
                place(child, height + _RISE)
                height = max(y for _, y in positions.values()) + 1.0 - _RISE  # above this branch

    place(START, 0.0)
    return {m: positions[m] for m in (START, *used)}


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
    """Return the positions of nodes, root first, leaves one apart, and edges (parent, child)."""
    positions: list[tuple[float, float]] = []
    edges: list[tuple[int, int]] = []
    leaves = count()

    def place(node: OrderedTree, height: float) -> int:
        number = len(positions)
        positions.append((0.0, height))
        below = [place(child, height + 1.0) for child in node.children]
        edges.extend((number, child) for child in below)
        x = (positions[below[0]][0] + positions[below[-1]][0]) / 2 if below else float(next(leaves))
        positions[number] = x, height
        return number

    place(tree, 0.0)
    return [(x - positions[0][0], height) for x, height in positions], edges


def stability_region(method: Any, ax: Any = None) -> Any:
    """Draw the boundaries ``|R(z)| = 1`` of stability regions of methods, with ``z = h λ``.

    R is the stability function of the classical method for ``y' = λ y``, to which a method reduces
    where flows commute. The regions where ``|R(z)| ≤ 1`` are filled; those of implicit
    methods may have no end.

    Parameters
    ----------
    method
        A method, its name, or a list of them.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> ax = cg.plot.stability_region(["CG2", "CF4"])
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['CG2', 'CF4']
    """
    several = isinstance(method, list | tuple) and len(method) > 0
    methods = [refuse_splitting(resolve_method(name)) for name in (method if several else [method])]
    grid, z = _plane(*_box(methods))
    ax = axes_for(ax)
    ax.axhline(0.0, color="#cccccc", linewidth=0.8, zorder=0)
    ax.axvline(0.0, color="#cccccc", linewidth=0.8, zorder=0)
    for k, drawn in enumerate(methods):
        size = np.abs(growth(drawn, z))
        colour, dashes = COLOURS[k % len(COLOURS)], _DASHES[k % len(_DASHES)]
        alpha = 0.25 if len(methods) == 1 else 0.12
        ax.contourf(*grid, size, levels=[0.0, 1.0], colors=[colour], alpha=alpha)
        ax.contour(*grid, size, levels=[1.0], colors=[colour], linestyles=[dashes])
        label = verbatim(drawn.name) or "without name"
        ax.plot([], [], color=colour, linestyle=dashes, label=label)
    ends = {"xlim": grid[0][0, [0, -1]], "ylim": grid[1][[0, -1], 0]}
    ax.set(aspect="equal", xlabel="Re hλ", ylabel="Im hλ", **ends)
    ax.legend(facecolor="white", edgecolor="none", fontsize=8, loc="upper left")
    return ax


def _plane(x: Range, y: Range) -> tuple[Any, Any]:
    """Return the coordinates of a grid, and its points z."""
    grid = np.meshgrid(np.linspace(*x, _POINTS), np.linspace(*y, _POINTS))
    return grid, grid[0] + 1j * grid[1]


def growth(method: Method, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the stability function R(z), the factor of a step of ``y' = λ y`` with ``z = h λ``."""
    if problem := reason_without_limits(method):
        raise ValueError(f"method must have fewer stages or digits, got {method!r}: {problem}")
    above, below = (np.array([float(c) for c in p]) for p in stability_function(method))
    with np.errstate(divide="ignore", invalid="ignore"):  # at poles
        return np.asarray(np.polyval(above[::-1], z) / np.polyval(below[::-1], z))


def _box(methods: list[Method]) -> tuple[Range, Range]:
    """Return ranges of both axes with the regions, or the inner part of endless regions."""
    reach = 2.0 + max(method.stages for method in methods)
    _, z = _plane((-2 * reach, 2 * reach), (0.0, 1.5 * reach))
    z = z[np.any([np.abs(growth(method, z)) <= 1.0 for method in methods], axis=0)]
    left, right, high = (float(end) for end in (z.real.min(), z.real.max(), z.imag.max()))
    margin = 0.15 * max(right - left, high)
    return (left - margin, right + margin), (-high - margin, high + margin)
