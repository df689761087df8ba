"""Words of ordered trees, the arguments of elementary weights, and order conditions.

Here a tree is the tuple of its children, ``()`` for ``τ``, and a word is a tuple of
letters; the weight of a tree is that of the word of its children.
"""

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import cache
from itertools import combinations
from typing import Any, NamedTuple

from cg.construction.conditions.counts import condition_trees
from cg.construction.trees.ordered import MAX_NODES, OrderedTree, forest

Word = tuple[Any, ...]
"""A tuple of words, the letters."""


class Condition(NamedTuple):
    """An order condition: that of the word's tree, for a row of weights of a pair, from 0."""

    row: int
    word: Word


@cache
def nodes(word: Word) -> int:
    """Return the number of nodes of the letters of a word, one less than of its tree."""
    return sum(1 + nodes(letter) for letter in word)


@cache
def reciprocal_density(word: Word) -> Fraction:
    """Return ``1/γ`` of the tree with these children."""
    product, before = Fraction(1), 0
    for letter in word:
        before += 1 + nodes(letter)
        product *= reciprocal_density(letter) / before
    return product


def is_of_time(word: Word) -> bool:
    """Return whether all letters are ``[τᵏ]``, powers of the time."""
    return not any(any(letter) for letter in word)


@cache
def condition_words(
    order: int, independent: bool = True, of_time: bool = False
) -> tuple[Word, ...]:
    """Return the words of `condition_trees`; if ``of_time``, only those of powers of the time."""
    if of_time:
        return tuple(filter(is_of_time, condition_words(order, independent)))
    trees = forest(order + 1)
    made: list[Word] = []
    for children in trees.children:
        made.append(tuple(made[child - 1] for child in children))
    return tuple(made[t - 1] for t in condition_trees(order, independent))


@cache
def words_with(count: int, of_time: bool = False) -> tuple[Word, ...]:
    """Return all words of trees with `count` nodes; there is one with none, the empty word."""
    if count == 0:
        return ((),)
    return tuple(w for w in condition_words(count, False, of_time) if nodes(w) == count)


def conditions_of(orders: Sequence[int], of_time: bool = False) -> list[Condition]:
    """Return the independent conditions of all rows of weights."""
    return [
        Condition(row, word)
        for row, order in enumerate(orders)
        for word in condition_words(order, True, of_time)
    ]


def add_multiple(total: dict[Any, Any], key: Any, change: Any) -> None:
    """Add to the coefficient of a word, or another key, in a combination."""
    total[key] = total[key] + change if key in total else change


def extend(function: Callable[[Word], dict[Word, int]], words: dict[Word, int]) -> dict[Word, int]:
    """Return the value of a linear function of words at a combination of words."""
    total: dict[Word, int] = {}
    for word, factor in words.items():
        for image, multiplicity in function(word).items():
            add_multiple(total, image, factor * multiplicity)
    return total


@cache
def shuffle(left: Word, right: Word) -> dict[Word, int]:
    """Return the shuffle product of two words, as multiplicities of words."""
    if not left or not right:
        return {left + right: 1}
    product: dict[Word, int] = {}
    for first, parts in ((left[0], shuffle(left[1:], right)), (right[0], shuffle(left, right[1:]))):
        for word, multiplicity in parts.items():
            product[(first, *word)] = product.get((first, *word), 0) + multiplicity
    return product


def closure(words: Iterable[Word]) -> list[Word]:
    """Return all nonempty factors of words, and of trees among their letters, letters first."""
    factors: set[Word] = set()
    pending = list(words)
    seen: set[Word] = set(pending)
    while pending:
        word = pending.pop()
        factors.update(word[begin:end] for begin, end in combinations(range(len(word) + 1), 2))
        for letter in word:
            if letter and letter not in seen:
                seen.add(letter)
                pending.append(letter)
    return sorted(factors, key=nodes)


def text(word: Word) -> str:
    """Write a word as the tree with these children, in brackets."""
    return f"[{''.join(map(text, word))}]"


def parse(tree: str) -> Word:
    """Read what `text` writes; ValueError if that isn't one tree in balanced brackets."""
    if tree.count("[") > MAX_NODES:
        raise ValueError(f"a tree must have at most {MAX_NODES} nodes, got {tree[:80]!r}")

    def convert(tree: OrderedTree) -> Word:
        return tuple(convert(child) for child in tree.children)

    return convert(OrderedTree.parse(tree))
