"""Search for methods of points: given trees, drawn trees, fewer flows."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.construction.layouts import Layout
from cg.construction.points import MethodError, check_tree
from cg.construction.search.candidate import Reduction, pack_method, solved
from cg.construction.search.shapes import draw_layout
from cg.construction.search.start import run_start
from cg.construction.solvers.system import ConditionSystem

FIVE = {"order": 5, "stages": 6, "seed": 1}


@pytest.fixture(scope="module")
def drawn():
    return cg.search(**FIVE, starts=60, flows=9, workers=2)


def test_drawn_trees_lead_to_methods_of_the_order(drawn):
    assert drawn.methods
    assert len({m.layout.parents for m in drawn.methods}) > 1
    for method in drawn.methods:
        assert isinstance(method, cg.CommutatorFree)
        assert (method.order, method.stages, method.exponentials) == (5, 6, 9)


def test_second_results_make_pairs():
    methods = cg.search(4, 5, 10, 1, flows=6, embedded=True).methods
    assert methods
    assert {(m.order, m.embedded_order, m.exponentials) for m in methods} == {(4, 3, 6)}


def test_trees_of_few_stages_and_many_flows_are_drawn():
    layout = draw_layout(3, 60, np.random.default_rng(0))
    assert {*layout.parents, *layout.stage_points, *layout.results} >= set(range(60))


def test_drawn_pairs_have_nonzero_estimates():
    result = cg.search(5, 7, 60, 1, flows=12, embedded=True, first_same_as_last=True, workers=2)
    assert result.settings.first_same_as_last
    assert len(result.methods) > 1
    for method in result.methods:
        layout = method.layout
        assert (method.order, method.embedded_order, method.stages) == (5, 4, 7)
        assert layout.stage_points[-1] == layout.results[0] == layout.parents[layout.results[1]]
        last = method.coefficients[-1].value
        assert abs(last) > 0.05
        # the conditions are homogeneous in the estimate's weights
        x = [float(entry.value) for entry in method.coefficients]
        x[layout.starts[-2] :] = [3 * entry for entry in x[layout.starts[-2] :]]
        assert np.abs(ConditionSystem(5, layout).residual(np.array(x))).max() < 1e-13


def test_pairs_whose_results_become_equal_are_left_out():
    tree = (-1, *range(8), 7), (-1, 0, 1, 3, 4, 5, 7), 8, 9
    result = cg.search(5, 7, 1, 1, tree=tree, bound=1.5, minimise="principal_error")
    start = run_start(result.settings, 45)
    assert start.exact
    assert replace(result, starts=(start,)).methods == ()


def test_search_resumes_from_store(tmp_path):
    path = tmp_path / "runs.jsonl"
    options = FIVE | {"flows": 9, "maxfev": 40}
    cg.search(**options, starts=4, store=path)
    result = cg.search(**options, starts=6, store=path)
    assert result == cg.search(**options, starts=6)


@pytest.mark.parametrize("embedded", [False, True])
@pytest.mark.parametrize(("stages", "flows"), [(1, 1), (2, 2), (4, 4), (6, 9), (7, 16)])
def test_drawn_trees_are_valid_and_use_every_flow(stages, flows, embedded):
    shapes = set()
    for seed in range(40):
        layout = draw_layout(stages, flows, np.random.default_rng(seed), embedded=embedded)
        shapes.add(layout)
        tree = layout.tree([1] * layout.size)
        check_tree(tree)
        assert (layout.stages, len(layout.parents)) == (stages, flows + embedded)
        assert {m for end in layout.ends for m in layout.path(end)} == set(range(flows + embedded))
        assert layout.pair == embedded
    assert len(shapes) > 20 or flows <= 4


@pytest.mark.parametrize(("tree", "message"), [
    (((-1, 0.5), (-1, 0)), "the parent of point 1 must be a point from -1 to 1, got 0.5"),
    (Layout((-1, -1), ((1,), (0,)), (-1, 0), (1,)), "point 0 must have weights on earlier"),
    (Layout.tableau(2), "tree must be one of points, got the layout of a tableau"),
])  # fmt: skip
@pytest.mark.parametrize("look", [cg.construct, lambda **rest: cg.search(starts=1, **rest)])
def test_rejects_invalid_trees(look, tree, message):
    refuses(MethodError, message, look, order=2, stages=2, seed=0, tree=tree)


def test_construct_drops_flows_of_drawn_trees(tmp_path):
    path = tmp_path / "trees"
    options = {**FIVE, "flows": 9, "first_flows": 10, "tries": 60}
    construction = cg.construct(**options, workers=2, store=path)
    method = construction.method
    assert (method.order, method.stages, method.exponentials) == (5, 6, 9)
    seeds = np.random.SeedSequence(1, spawn_key=(construction.best.index,))
    assert len(draw_layout(6, 10, np.random.default_rng(seeds)).parents) == 10
    again = cg.construct(**options, workers=1, store=path)
    assert again == construction
    assert cg.construct(**options, workers=1) == construction


def test_dropping_flow_leaves_solution():
    candidate = pack_method(cg.search(4, 6, 20, 1, flows=9).methods[0])
    fewer = Reduction(np.random.default_rng(1), largest=10.0).drop_flow(candidate)
    assert solved(fewer)
    assert (fewer.system.stages, len(fewer.system.layout.parents)) == (6, 8)
