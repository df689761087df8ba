"""Limits: large orders, deep trees, complex numbers, full disks, long texts."""

import numpy as np
import pytest

import cg
from cg import conditions
from cg.construction.search.settings import default_start
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.construction.trees.ordered import OrderedTree


def test_construct_starts_at_the_highest_order():
    construction = cg.construct(8, 20, seed=0, tries=1, iterations=1, first_stages=20, force=True)
    assert not construction.exact
    assert construction.tries == 1


@pytest.mark.parametrize("structure", Structure)
def test_default_starts_of_all_orders(structure):
    most = conditions.MAX_ORDER if structure is Structure.GENERAL else 8
    for order in range(4, most + 1):
        start = default_start(order, structure)
        system = ConditionSystem.tableau(order, start.stages, structure=structure)
        assert system.movable.size >= system.equations


def test_deep_trees():
    depth = 5000
    text = "[" * depth + "]" * depth
    tree, same = OrderedTree.parse(text), OrderedTree.parse(text)
    other = OrderedTree.parse("[" * depth + "[]" + "]" * depth)
    assert tree == same
    assert hash(tree) == hash(same)
    assert tree != other
    assert tree != text
    assert (tree.nodes, other.nodes) == (depth, depth + 1)
    assert str(tree) == text
    assert repr(tree) == f"OrderedTree.parse({text!r})"
    small = OrderedTree.parse("[" * 20 + "]" * 20)
    assert small.density == 121645100408832000  # 19!
    assert {tree: 1}[same] == 1


def test_warnings_point_to_the_caller():
    method = cg.Tableau([[]], ["1/2"], name="half")
    for call in (cg.integrate, cg.solve_ivp):
        with pytest.warns(UserWarning, match="has order 0") as caught:
            call(
                lambda t, y: np.zeros(3), (0, 1), np.eye(3), frame=cg.frames.SO3(), method=method,
                h=0.5,
            )  # fmt: skip
        assert caught[0].filename == __file__
