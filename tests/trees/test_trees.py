from fractions import Fraction
from math import factorial

import pytest
from hypothesis import given
from refusals import refuses
from strategies import trees

from cg.construction.trees import (
    OrderedTree,
    catalan,
    density,
    forest,
    is_lyndon,
    node_count,
    rooted_trees,
    rooted_trees_through,
)


def test_counts_are_catalan_numbers():
    ordered = forest(10)
    counts = [len(ordered.with_nodes(n)) for n in range(1, 11)]
    assert counts == [catalan(n) for n in range(10)] == [1, 1, 2, 5, 14, 42, 132, 429, 1430, 4862]
    assert len(ordered) == sum(map(catalan, range(10)))


def test_independent_trees_are_counted_by_aperiodic_necklaces():
    # OEIS A022553
    ordered = forest(9)
    actual = [sum(map(ordered.is_independent, ordered.with_nodes(n))) for n in range(2, 10)]
    assert actual == [1, 1, 3, 8, 25, 75, 245, 800]


@given(trees)
def test_text_round_trip(tree):
    assert OrderedTree.parse(str(tree)) == tree
    assert eval(repr(tree)) == tree
    assert str(tree).count("[") == tree.nodes


@pytest.mark.parametrize("text", ["", "[", "]", "[]]", "[][]", "[[]", "x", "[x]", "][", "()"])
def test_bad_text_is_refused(text):
    refuses(ValueError, "text", OrderedTree.parse, text)


def test_bad_types_are_refused():
    refuses(TypeError, "text must", OrderedTree.parse, b"[]")
    refuses(TypeError, "tuple of OrderedTree", OrderedTree, [OrderedTree()])
    refuses(TypeError, "tuple of OrderedTree", OrderedTree, ("[]",))


def test_density_of_bushy_and_tall_trees():
    bushy, tall = OrderedTree(), OrderedTree()
    for n in range(1, 7):
        bushy = OrderedTree((*bushy.children, OrderedTree()))
        tall = OrderedTree((tall,))
        assert bushy.density == factorial(n)
        assert tall.density == factorial(n)


@pytest.mark.parametrize(
    ("text", "density"), [("[[][[]]]", 3), ("[[[]][]]", 6), ("[[][][[]]]", 8), ("[[[][]][]]", 24)]
)
def test_density_depends_on_the_order_of_children(text, density):
    assert OrderedTree.parse(text).density == density


@pytest.mark.parametrize("nodes", range(1, 10))
def test_reciprocal_densities_sum_to_one(nodes):
    # their generating function solves W' = W², W(0) = 1
    ordered = forest(nodes)
    assert sum(Fraction(1, ordered.density[t - 1]) for t in ordered.with_nodes(nodes)) == 1


def test_tables_agree_with_the_trees():
    ordered = forest(7)
    assert len(set(ordered)) == len(ordered)
    for index, tree in enumerate(ordered, 1):
        word = ordered.children[index - 1]
        assert [ordered.tree(letter) for letter in word] == list(tree.children)
        assert all(letter < index for letter in word)


def test_lyndon_words():
    assert [is_lyndon(w) for w in ([1], [1, 2], [1, 1, 2], [1, 2, 1, 3])] == [True] * 4
    assert [is_lyndon(w) for w in ([], [1, 1], [2, 1], [1, 2, 1], [1, 2, 1, 2])] == [False] * 5


def test_bad_index():
    ordered = forest(3)
    for index in (0, len(ordered) + 1):
        refuses(IndexError, f"index must be between 1 and 4, got {index}", ordered.tree, index)
    refuses(ValueError, "nodes must", ordered.with_nodes, 4)
    refuses(ValueError, "nodes must", ordered.with_nodes, 0)


def test_nodes_and_densities():
    assert [density(tree) for tree in rooted_trees(4)] == [24, 12, 8, 4]
    for n in range(1, 8):
        assert {node_count(tree) for tree in rooted_trees(n)} == {n}


@pytest.mark.parametrize("function", [rooted_trees, rooted_trees_through])
def test_rejects_a_bad_number_of_nodes(function):
    refuses(ValueError, "between 1 and 14", function, 0)
    refuses(TypeError, "must be an integer", function, 2.5)


def test_deep_trees():
    text = "[" * 200 + "]" * 200
    tree, same = OrderedTree.parse(text), OrderedTree.parse(text)
    assert tree == same
    assert tree != OrderedTree.parse("[" * 198 + "[]" + "]" * 198)
    assert tree != text
    assert {tree: 1}[same] == 1
    assert (tree.nodes, str(tree)) == (200, text)
    small = OrderedTree.parse("[" * 20 + "]" * 20)
    assert small.density == 121645100408832000  # 19!
    refuses(ValueError, "at most 200 nodes", OrderedTree.parse, "[" * 5000 + "]" * 5000)
