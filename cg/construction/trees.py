"""Ordered rooted trees, the index set of the order conditions.

An ordered tree is the list of its children, ``t = [t_1 ... t_mu]``, from left to right; the tree
without children is ``τ = []``. Rooted trees, whose children have no order, are the index set of the
classical order conditions.

The build runs this file as a script, which writes the tables of ordered trees in Fortran: at its
top it imports only the standard library. It replaces the Maple program of the paper, Section 3.1.
"""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate, combinations_with_replacement, product
from math import comb, prod
from operator import index as to_int
from pathlib import Path

_MAX_PARSED = 200  # nodes of a text: deeper trees would exceed Python's limit of recursion


@dataclass(frozen=True)
class OrderedTree:
    """An ordered rooted tree, immutable and hashable.

    Parameters
    ----------
    children
        The subtrees of the root, from left to right.

    Examples
    --------
    >>> t = OrderedTree.parse("[[][[]]]")
    >>> t.nodes, t.density
    (4, 3)
    >>> str(t)
    '[[][[]]]'
    """

    children: tuple[OrderedTree, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.children, tuple) or not all(
            isinstance(child, OrderedTree) for child in self.children
        ):
            raise TypeError(f"children must be a tuple of OrderedTree, got {self.children!r}")

    @classmethod
    def parse(cls, text: str) -> OrderedTree:
        """Read a tree from its text in brackets, of at most 200 nodes; white space is ignored."""
        if not isinstance(text, str):
            raise TypeError(f"text must be a str, got {type(text).__name__}")
        if text.count("[") > _MAX_PARSED:
            raise ValueError(f"a tree must have at most {_MAX_PARSED} nodes, got {text[:80]!r}")
        open_children: list[list[OrderedTree]] = [[]]
        for position, character in enumerate(text):
            if character.isspace():
                continue
            if character == "[":
                open_children.append([])
            elif character == "]" and len(open_children) > 1:
                children = open_children.pop()
                open_children[-1].append(cls(tuple(children)))
            else:
                raise ValueError(f"text must be brackets in pairs, got {character!r} at {position}")
        if len(open_children) != 1 or len(open_children[0]) != 1:
            raise ValueError(f"text must be one tree in balanced brackets, got {text!r}")
        return open_children[0][0]

    def __str__(self) -> str:
        return f"[{''.join(map(str, self.children))}]"

    def __repr__(self) -> str:
        return f"OrderedTree.parse({str(self)!r})"

    @cached_property
    def nodes(self) -> int:
        """Number of nodes ``|t|``, the root included."""
        return 1 + sum(child.nodes for child in self.children)

    @cached_property
    def density(self) -> int:
        """Density ``γ(t) = Π_k (|t_1|+…+|t_k|) γ(t_k)``, and 1 for ``τ`` ([13] of the paper)."""
        sums = accumulate(child.nodes for child in self.children)
        return prod(sums) * prod(child.density for child in self.children)


MAX_NODES = 14
"""Largest number of nodes of a `Forest`, which then has a million trees."""


def catalan(n: int) -> int:
    """Return the Catalan number ``C_n``, the number of ordered trees with n + 1 nodes."""
    return comb(2 * n, n) // (n + 1)


def _integer(name: str, value: object, upper: int | None = None) -> int:
    """Return `value` as an int, from 1 to `upper` if given; other modules use `check_integer`."""
    try:
        if isinstance(value, bool):
            raise TypeError
        checked = to_int(value)  # type: ignore[arg-type]
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {value!r}") from None
    if upper is not None and not 1 <= checked <= upper:
        raise ValueError(f"{name} must be between 1 and {upper}, got {checked}")
    return checked


def is_lyndon(word: Sequence[int]) -> bool:
    """Return whether a word is nonempty and smaller than each of its proper suffixes."""
    word = tuple(word)
    return bool(word) and all(word < word[k:] for k in range(1, len(word)))


@dataclass(frozen=True)
class Forest:
    """All ordered trees with at most `max_nodes` nodes, each with an integer index.

    Indices start at 1 (``τ``), as in the generated Fortran. Trees with fewer nodes come first;
    among those with equally many, the one whose first child has the smaller index, and so on. The
    indices of `children` and all other attributes are those of the trees by ``tree index - 1``.
    """

    max_nodes: int
    children: tuple[tuple[int, ...], ...]

    def __len__(self) -> int:
        return len(self.children)

    @cached_property
    def nodes(self) -> tuple[int, ...]:
        """Number of nodes of each tree."""
        return tuple(n for n in range(1, self.max_nodes + 1) for _ in self.with_nodes(n))

    @cached_property
    def density(self) -> tuple[int, ...]:
        """Density ``γ(t)`` of each tree."""
        densities: list[int] = []
        for word in self.children:
            sums = accumulate(self.nodes[letter - 1] for letter in word)
            densities.append(prod(sums) * prod(densities[letter - 1] for letter in word))
        return tuple(densities)

    def with_nodes(self, nodes: int) -> range:
        """Return the indices of the trees with exactly `nodes` nodes."""
        nodes = _integer("nodes", nodes, self.max_nodes)
        start = 1 + sum(catalan(n - 1) for n in range(1, nodes))
        return range(start, start + catalan(nodes - 1))

    def is_independent(self, index: int) -> bool:
        """Return whether the condition of a tree is independent of conditions of lower order.

        ``Φ`` is a character of the shuffle algebra of words of trees, which is freely generated by
        the Lyndon words (letters ordered by their index).
        """
        return is_lyndon(self.children[self._position(index)])

    def tree(self, index: int) -> OrderedTree:
        """Return the tree with this index; IndexError if there is none."""
        return self._trees[self._position(index)]

    def index(self, tree: OrderedTree) -> int:
        """Return the index of `tree`; KeyError if it has more than `max_nodes` nodes."""
        if not isinstance(tree, OrderedTree):
            raise TypeError(f"tree must be an OrderedTree, got {tree!r}")
        try:
            return self._indices[tree]
        except KeyError:
            raise KeyError(f"{tree} has {tree.nodes} nodes, more than {self.max_nodes}") from None

    def __iter__(self) -> Iterator[OrderedTree]:
        return iter(self._trees)

    def _position(self, index: int) -> int:
        index = _integer("index", index)
        if not 1 <= index <= len(self):
            raise IndexError(f"index must be between 1 and {len(self)}, got {index}")
        return index - 1

    @cached_property
    def _trees(self) -> tuple[OrderedTree, ...]:
        trees: list[OrderedTree] = []
        for word in self.children:
            trees.append(OrderedTree(tuple(trees[letter - 1] for letter in word)))
        return tuple(trees)

    @cached_property
    def _indices(self) -> dict[OrderedTree, int]:
        return {tree: index for index, tree in enumerate(self._trees, 1)}


def forest(max_nodes: int) -> Forest:
    """Return the `Forest` of all ordered trees with at most `max_nodes` nodes.

    ValueError unless this is between 1 and `MAX_NODES`, TypeError if it isn't an integer.

    Examples
    --------
    The trees of the conditions of order two, `cg.conditions.condition_trees`:

    >>> [str(forest(3).tree(index)) for index in (2, 3, 4)]
    ['[[]]', '[[][]]', '[[[]]]']
    """
    return _forest(_integer("max_nodes", max_nodes, MAX_NODES))


@cache
def _forest(max_nodes: int) -> Forest:
    children: list[tuple[int, ...]] = [()]
    start = [0, 1]  # start[n] is the first index with n nodes
    for n in range(2, max_nodes + 1):
        start.append(len(children) + 1)
        for size in range(1, n):
            heads = range(start[size], start[size + 1])
            tails = range(start[n - size], start[n - size + 1])
            children += [(head, *children[tail - 1]) for head, tail in product(heads, tails)]
    return Forest(max_nodes, tuple(children))


RootedTree = tuple["RootedTree", ...]
"""The children of the root, each multiset in one sequence only; ``()`` is the single node."""


def rooted_trees(nodes: int) -> tuple[RootedTree, ...]:
    """Return the 1, 1, 2, 4, 9, 20, 48, 115, … rooted trees with 1, 2, … `nodes`."""
    return _rooted_trees(_integer("nodes", nodes, MAX_NODES))


def rooted_trees_through(order: int) -> tuple[RootedTree, ...]:
    """Return the rooted trees with 1 to `order` nodes, at most `MAX_NODES`, smaller ones first."""
    order = _integer("order", order, MAX_NODES)
    return tuple(tree for nodes in range(1, order + 1) for tree in _rooted_trees(nodes))


@cache
def _rooted_trees(nodes: int) -> tuple[RootedTree, ...]:
    return tuple(_multisets(nodes - 1, nodes - 1))


def _multisets(nodes: int, max_nodes: int) -> Iterator[tuple[RootedTree, ...]]:
    """Yield the multisets of trees with `nodes` nodes in total, each with at most `max_nodes`."""
    if nodes == 0:
        yield ()
    for size in range(min(nodes, max_nodes), 0, -1):
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


_PER_STATEMENT = 480  # compilers limit the length of a list and its continuation lines


def _data(name: str, values: Sequence[int]) -> Iterator[str]:
    for begin in range(0, len(values), _PER_STATEMENT):
        chunk = values[begin : begin + _PER_STATEMENT]
        yield f"  data {name}({begin + 1}:{begin + len(chunk)}) / &"
        rows = textwrap.wrap(", ".join(map(str, chunk)) + " /", width=90)
        yield " &\n".join(f"    {row}" for row in rows)


def fortran_tables(trees: Forest) -> str:
    """Return the Fortran module ``tree_tables`` for conditions up to order ``max_nodes - 1``.

    Order conditions are stated for words of trees. So a tree also stands for the word of its
    children, and parts of it are those of smaller trees.
    """
    total = len(trees)
    index_of = {word: index for index, word in enumerate(trees.children, 1)}
    first = [0, *(word[0] for word in trees.children[1:])]
    rest = [0, *(index_of[word[1:]] for word in trees.children[1:])]
    head = [index_of[word[:k]] for word in trees.children for k in range(len(word) + 1)]
    tail = [index_of[word[k:]] for word in trees.children for k in range(len(word) + 1)]
    child_start = list(accumulate(map(len, trees.children), initial=1))
    letters = [letter for word in trees.children for letter in word]
    split_start = [start + k for k, start in enumerate(child_start)]
    condition = [index if trees.is_independent(index) else 0 for index in range(1, total + 1)]
    tree_start = [trees.with_nodes(n).start for n in range(1, trees.max_nodes + 1)] + [total + 1]
    integers: list[tuple[str, str, Sequence[int]]] = [
        ("tree_start", "first index of the trees with n nodes", tree_start),
        ("node_count", "nodes of a tree", trees.nodes),
        ("child_start", "where a tree's children begin in child", child_start),
        ("child", "indices of the children, tree after tree", letters),
        ("first", "index of the first child, 0 for the single node", first),
        ("rest", "index of the tree without its first child", rest),
        ("split_start", "where a tree's cuts begin in head and tail", split_start),
        ("head", "the words of the first 0, 1, ... children", head),
        ("tail", "the words of the others", tail),
        ("condition", "the tree's index, 0 where its condition follows from lower ones", condition),
    ]
    lines = [
        "! Generated by cg/construction/trees.py: ordered trees and the conditions they index.",
        "module tree_tables",
        "  use, intrinsic :: iso_fortran_env, only: int64",
        "  implicit none",
        "  private",
        f"  integer, parameter, public :: highest_order = {trees.max_nodes - 1}",
        f"  integer, parameter, public :: tree_total = {total}",
    ]
    for name, meaning, values in integers:
        lines.append(f"  integer, public, protected, save :: {name}({len(values)})  ! {meaning}")
    lines.append("  integer(int64), public, protected, save :: density(tree_total)  ! gamma(t)")
    for name, _, values in integers:
        lines.extend(_data(name, values))
    lines.extend(_data("density", trees.density))
    lines.append("end module tree_tables")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the module to the named file."""
    parser = argparse.ArgumentParser(description="Write the Fortran tables of ordered trees.")
    parser.add_argument("--order", type=int, required=True, help="highest order of a condition")
    parser.add_argument("--output", type=Path, required=True, help="the Fortran file to write")
    options = parser.parse_args(arguments)
    if options.order < 1:
        parser.error(f"--order must be at least 1, got {options.order}")
    options.output.write_text(fortran_tables(forest(options.order + 1)), encoding="ascii")


if __name__ == "__main__":
    main()
