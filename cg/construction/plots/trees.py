"""Plots of ordered trees."""

from itertools import count
from typing import Any

from cg.construction.trees.ordered import OrderedTree
from cg.plot.style import COLOURS, axes_for, blank
from cg.support.checks import check_flag

_MAX_NODES = 200


def tree(tree: OrderedTree | str, ax: Any = None, *, title: bool = True) -> Any:
    """Draw an ordered tree with its root at the bottom and children from left to right.

    Parameters
    ----------
    tree
        A tree, or its bracket notation; at most 200 nodes.
    title
        Whether to write the bracket notation and the density γ below.

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
    if check_flag("title", title):
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
