"""Rooted trees whose children have no order: the index set of the classical order conditions."""

from collections.abc import Iterator
from functools import cache
from itertools import combinations_with_replacement, product
from math import prod

from cg.construction.trees.ordered import MAX_NODES, OrderedTree
from cg.support.checks import check_integer

RootedTree = tuple["RootedTree", ...]
"""The children of the root, each multiset in one sequence only; ``()`` is the single node."""


def rooted_trees(nodes: int) -> tuple[RootedTree, ...]:
    """Return the 1, 1, 2, 4, 9, 20, 48, 115, … rooted trees with 1, 2, … `nodes`."""
    return _rooted_trees(check_integer("nodes", nodes, 1, MAX_NODES))


def rooted_trees_through(order: int) -> tuple[RootedTree, ...]:
    """Return the rooted trees with 1 to `order` nodes, at most `MAX_NODES`, smaller ones first."""
    order = check_integer("order", order, 1, MAX_NODES)
    return tuple(tree for nodes in range(1, order + 1) for tree in _rooted_trees(nodes))


@cache
def _rooted_trees(nodes: int) -> tuple[RootedTree, ...]:
    return tuple(_multisets(nodes - 1, nodes - 1))


def _multisets(nodes: int, largest: int) -> Iterator[tuple[RootedTree, ...]]:
    """Yield the multisets of trees with `nodes` nodes in total, each with at most `largest`."""
    if nodes == 0:
        yield ()
    for size in range(min(nodes, largest), 0, -1):
        for multiplicity in range(nodes // size, 0, -1):
            largest_ones = combinations_with_replacement(_rooted_trees(size), multiplicity)
            others = _multisets(nodes - size * multiplicity, size - 1)
            for trees, rest in product(largest_ones, others):
                yield trees + rest


@cache
def node_count(tree: RootedTree) -> int:
    """Return the number of nodes of a rooted tree."""
    return 1 + sum(map(node_count, tree))


@cache
def density(tree: RootedTree) -> int:
    """Return ``γ(t)``, the number of nodes times the densities of the children."""
    return node_count(tree) * prod(map(density, tree))


def planted(tree: RootedTree) -> OrderedTree:
    """Return a rooted tree with its children in one of their sequences."""
    return OrderedTree(tuple(map(planted, tree)))
