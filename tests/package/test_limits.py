"""Limits: large orders, deep trees, complex numbers, full disks, long texts."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cg
from cg import conditions
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.construction.start import default_start
from cg.proofs.dependent.identities import MiddleAbscissae, StageOrderTwo
from cg.proofs.dependent.relations import kept_words
from cg.trees.ordered import OrderedTree


def test_construct_starts_at_the_highest_order() -> None:
    construction = cg.construct(8, 60, seed=0, tries=1, iterations=1, first_stages=60)
    assert not construction.exact
    assert construction.tries == 1


@pytest.mark.parametrize("structure", Structure)
def test_default_starts_of_all_orders(structure: Structure) -> None:
    most = conditions.MAX_ORDER if structure is Structure.GENERAL else 8
    for order in range(4, most + 1):
        start = default_start(order, structure)
        system = ConditionSystem.tableau(order, start.stages, structure=structure)
        assert system.free.size >= system.equations


@pytest.mark.parametrize("order", [4, 5, 6, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize("structure", [Structure.STAGE_ORDER_TWO, Structure.MIDDLE])
def test_number_of_equations(structure: Structure, order: int) -> None:
    identities: list[Any] = [StageOrderTwo(1)]
    held = {1}
    if structure is Structure.MIDDLE:
        identities.append(MiddleAbscissae())
        held.add(0)
    count = sum(len(list(kept_words(n, identities, held))) for n in range(1, order + 1))
    system = ConditionSystem.tableau(order, 20, structure=structure)
    assert system.equations == count + int(structure) * 18


def test_stop_iteration_in_a_generator() -> None:
    def generator() -> Iterator[float]:
        raise StopIteration("inside")
        yield 0.0

    with pytest.raises(RuntimeError, match="generator raised StopIteration"):
        cg.integrate(
            lambda t, y: list(generator()),
            (0, 1),
            np.eye(3),
            frame=cg.frames.SO3(),
            method="CG3",
            h=0.1,
        )


def test_count_classical() -> None:
    # rooted trees with 1, 2, ... nodes: A000081 in the On-Line Encyclopedia of Integer Sequences
    trees = [1, 1, 2, 4, 9, 20, 48, 115, 286, 719]
    for order in range(1, 11):
        assert conditions.count_classical(order) == sum(trees[:order])
    assert conditions.count_classical(2000) > 2**2000


def test_deep_trees() -> None:
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


def test_search_with_wide_guesses() -> None:
    result = cg.search(3, 3, 2, 0, width=1e300, maxfev=5)
    assert not result.methods
    assert result.best.largest_residual > 0
    with pytest.raises(ValueError, match="width must be at most 1e"):
        cg.search(3, 3, 2, 0, width=1e301)
    construction = cg.construct(3, 3, seed=0, width=1e300, tries=2)
    assert not construction.exact


def test_search_results_have_short_reprs() -> None:
    result = cg.search(3, 3, 40, 0)
    assert re.fullmatch(
        r"<SearchResult: order 3, 3 stages, seed 0: \d+ of 40 starts exact>", repr(result)
    )
    assert len(repr(result.best)) < 500
    assert len(repr(cg.construct(4, 6, seed=0))) < 1000


_FULL = """
import resource, sys
from cg.reproduce.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
sys.exit(main(["--out", sys.argv[1], "--only", sys.argv[2]]))
"""


def test_full_disk_is_reported(tmp_path: Path) -> None:
    from cg.reproduce.items import ITEMS

    assert "fig4.1" in ITEMS
    command = [sys.executable, "-c", _FULL, str(tmp_path / "out"), "fig4.1"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert re.match(r"reproduce-paper: error: \S+: File too large; ", run.stderr)
    assert "Traceback" not in run.stderr


def test_minimum_versions_of_dependencies() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))
    floors = dict(entry.split(">=") for entry in project["project"]["dependencies"])
    assert floors["python-flint"] >= "0.7"  # polynomials of several variables
    assert floors["matplotlib"] >= "3.9"


def test_warnings_point_to_the_caller() -> None:
    method = cg.Tableau([[]], ["1/2"], name="half")
    for call in (cg.integrate, cg.solve_ivp):
        with pytest.warns(UserWarning, match="has order 0") as caught:
            call(
                lambda t, y: np.zeros(3),
                (0, 1),
                np.eye(3),
                frame=cg.frames.SO3(),
                method=method,
                h=0.5,
            )
        assert caught[0].filename == __file__


def test_structures_have_orders_up_to_eight() -> None:
    with pytest.raises(ValueError, match="order must be at most 8 with a structure, got 9"):
        ConditionSystem.tableau(9, 100, structure=Structure.MIDDLE)
