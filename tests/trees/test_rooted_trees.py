"""Rooted trees against the literature."""

from itertools import accumulate

import pytest
from refusals import refuses

from cg.trees.rooted import density, node_count, rooted_trees, rooted_trees_through

COUNTS = [1, 1, 2, 4, 9, 20, 48, 115, 286]  # OEIS A000081


def test_counts():
    trees = [rooted_trees(n) for n in range(1, 10)]
    assert [len(set(of_size)) for of_size in trees] == COUNTS
    assert list(map(len, trees)) == COUNTS
    assert list(map(len, map(rooted_trees_through, range(1, 10)))) == list(accumulate(COUNTS))


def test_nodes_and_densities():
    assert [density(tree) for tree in rooted_trees(4)] == [24, 12, 8, 4]
    for n in range(1, 8):
        assert {node_count(tree) for tree in rooted_trees(n)} == {n}


@pytest.mark.parametrize("function", [rooted_trees, rooted_trees_through])
def test_rejects_a_bad_number_of_nodes(function):
    refuses(ValueError, "at least 1", function, 0)
    refuses(TypeError, "must be an integer", function, 2.5)
