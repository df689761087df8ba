"""Random searches: reproducibility, methods, requirements, arguments, trees of points."""

import re
from dataclasses import replace
from fractions import Fraction
from operator import attrgetter

import numpy as np
import pytest
from quotients import jacobian
from refusals import refuses

import cg
from cg import conditions
from cg.construction.catalogue import methods
from cg.construction.conditions import Rows, residuals, unknowns, unpack
from cg.construction.layouts import Layout
from cg.construction.methods.estimate import estimate_ratio
from cg.construction.methods.low_storage import two_registers
from cg.construction.points import MethodError, check_tree
from cg.construction.search.candidate import Reduction, pack_method, solved
from cg.construction.search.random_search import search
from cg.construction.search.shapes import draw_layout, start_generator
from cg.construction.search.start import EXACT, run_start
from cg.construction.solvers.held import read_hold, register_chain
from cg.construction.solvers.system import ConditionSystem
from cg.support.shared_numbers import LmdifStatus, MinimumNormStatus

ORDER_FOUR = {"order": 4, "stages": 5, "starts": 24, "seed": 3}
SMALL = {"order": 3, "stages": 3, "seed": 5, "workers": 1}
PATTERNS = {"explicit": Rows.EXPLICIT, "diagonal": Rows.DIAGONAL, "full": Rows.FULL}


@pytest.fixture(scope="module")
def search_of_order_four():
    return search(**ORDER_FOUR, workers=1)


@pytest.fixture(scope="module")
def lmdif_search():
    return search(order=4, stages=5, starts=8, seed=2, algorithm="lmdif")


def largest_exact(x, settings):
    a, b = unpack([Fraction(entry) for entry in x], settings.stages, settings.rows)
    return max(map(abs, residuals(a, b, settings.order, arithmetic="exact")))


class TestReproducible:
    @pytest.mark.parametrize("index", [0, 7, 23])
    def test_start_reruns_alone(self, search_of_order_four, index):
        assert run_start(search_of_order_four.settings, index) == search_of_order_four.starts[index]

    def test_guesses_are_uniform(self):
        def draw(seed, index, width):
            return start_generator(seed, index).uniform(-width, width, 1000)

        guess = draw(3, 7, 0.25)
        np.testing.assert_array_equal(guess, draw(3, 7, 0.25))
        np.testing.assert_allclose(draw(3, 7, 1.0), 4 * guess)
        assert 0.24 < np.abs(guess).max() <= 0.25
        assert abs(guess.mean()) < 0.02
        assert not np.intersect1d(guess, draw(3, 8, 0.25)).size
        assert not np.intersect1d(guess, draw(4, 7, 0.25)).size


class TestMethods:
    def test_methods_are_exact(self, search_of_order_four):
        exact = [start for start in search_of_order_four.starts if start.exact]
        assert len(exact) == len(search_of_order_four.methods) >= 2
        for start in exact:
            scale = max(1, *(abs(Fraction(entry)) for entry in start.x))
            assert largest_exact(start.x, search_of_order_four.settings) <= Fraction(EXACT) * scale
            assert len(start.x) == 15

    @pytest.mark.parametrize("rows", PATTERNS)
    def test_methods_have_order_of_search(self, rows):
        result = search(4, 5, 40, seed=1, rows=rows)
        assert len(result.methods) >= 5
        for method in result.methods:
            assert method.order == 4
            assert method.rows == PATTERNS[rows]
            assert method.max_residual() < 1e-33

    def test_equal_methods_are_listed_once(self):
        result = search(2, 1, 30, seed=1, rows="diagonal")
        assert all(start.exact for start in result.starts)
        assert [method.exact for method in result.methods] == [methods["ImplicitMidpoint"].exact]

    @pytest.mark.parametrize("algorithm", ["minimum-norm", "lmdif"])
    def test_nothing_is_exact_without_refinement(self, algorithm):
        result = search(3, 3, 6, seed=1, refine_below=0, algorithm=algorithm)
        assert all(start.quad is None and not start.exact for start in result.starts)
        assert result.methods == ()
        assert result.best.max_residual < 1e-8

    def test_evaluations_are_bounded(self):
        for start in search(4, 5, 10, seed=1, maxfev=20).starts:
            assert start.double.nfev <= 21  # and one of the guess
            if not start.exact:
                assert start.double.info == MinimumNormStatus.OUT_OF_ITERATIONS

    def test_phases_have_a_status_each(self):
        """A fit that stops close to a solution doesn't solve the conditions, its refinement may."""
        for start in search(4, 5, 10, seed=1, maxfev=20, refine_below=1e9).starts:
            assert (start.quad.info == MinimumNormStatus.SOLVED) == start.exact


class TestThePapersWay:
    def test_lmdif_phases_as_in_paper(self, lmdif_search):
        solved = [start for start in lmdif_search.starts if start.exact]
        for start in solved:
            assert start.double.f < 1e-25
            assert start.quad is not None
            assert start.quad.f < 1e-62
            assert start.quad.nfev > 16  # at least one Jacobian by differences
            assert LmdifStatus(start.double.info).converged or start.double.info >= 5
        for start in lmdif_search.starts:
            if not start.exact:
                assert start.quad is None or start.quad.f > 1e-40


class TestImplicit:
    @pytest.mark.parametrize("name", PATTERNS)
    def test_rows_by_name_and_value(self, name):
        by_name = search(3, 4, 2, seed=1, rows=name)
        assert by_name == search(3, 4, 2, seed=1, rows=PATTERNS[name])
        assert by_name == search(3, 4, 2, seed=1, rows=int(PATTERNS[name]))
        assert by_name.settings.rows is PATTERNS[name]
        assert len(by_name.best.x) == unknowns(4, PATTERNS[name])

    def test_finds_methods_with_fewer_unknowns_than_conditions(self):
        result = search(4, 3, 200, seed=1, rows="diagonal", force=True)
        (method,) = result.methods
        np.testing.assert_allclose(method.a, methods["DICG4"].a, atol=1e-15)
        assert len(result.best.x) == 9 < conditions.count(4, independent=True)


class TestArguments:
    @pytest.mark.parametrize(("order", "stages", "rows", "size", "independent"), [
        (3, 2, "explicit", 3, 5), (4, 4, "explicit", 10, 13), (6, 14, "explicit", 105, 113),
        (4, 3, "diagonal", 9, 13), (4, 3, "full", 12, 13), (5, 5, "full", 30, 38),
    ])  # fmt: skip
    def test_rejects_too_few_stages(self, order, stages, rows, size, independent):
        with pytest.raises(ValueError, match=rf"gives {size} unknowns for {independent} indep"):
            search(order, stages, 1, seed=1, rows=rows)
        forced = search(order, stages, 1, seed=1, rows=rows, force=True, maxfev=4)
        assert len(forced.best.x) == size


@pytest.fixture(scope="module")
def search_of_order_three():
    return search(**SMALL, starts=40)


class TestRequirements:
    @pytest.mark.parametrize("minimise", [None, "principal_error", "largest_coefficient"])
    def test_methods_satisfy_the_bounds(self, search_of_order_three, minimise):
        bounds = {"abscissae": (0, 1), "bound": 1.5}
        result = search(**SMALL, starts=40, **bounds, minimise=minimise)
        assert result.starts == search_of_order_three.starts
        assert 0 < len(result.methods) < len(search_of_order_three.methods)
        for method in result.methods:
            assert method.order == 3
            assert method.max_residual() < 1e-33
            assert method.c.min() >= 0.0
            assert method.c.max() <= 1.0
            assert largest(method) <= 1.5

    @pytest.mark.parametrize("minimise", ["principal_error", "largest_coefficient"])
    def test_minimised_methods(self, search_of_order_three, minimise):
        objective = attrgetter(minimise) if minimise == "principal_error" else largest
        selected = search(**SMALL, starts=40, minimise=minimise).methods
        values = list(map(objective, selected))
        assert values == pytest.approx(sorted(values), abs=1e-7)
        before = {method.name: method for method in search_of_order_three.methods}
        ratios = [objective(method) / objective(before[method.name]) for method in selected]
        assert 5 <= len(ratios) < len(before)  # several reach one minimum
        assert max(ratios) < 1.05
        assert min(ratios) < 0.8
        assert (
            selected[0].source == before[selected[0].name].source + ", then along the solution set"
        )

    def test_methods_within_the_bounds_stay_as_they_are(self, search_of_order_three):
        selected = search(
            **SMALL, starts=40, bound=largest(search_of_order_three.methods[3]) + 1e-3
        ).methods
        assert set(search_of_order_three.methods[:4]) <= set(selected)

    def test_intervals_by_name(self):
        bound = {"c": (0, 1), "b[2]": (0.1, None), "a[3,1]": (None, 0.3)}
        result = search(4, 6, 20, 1, workers=1, bound=bound)
        assert 0 < len(result.methods) < result.exact_starts
        for method in result.methods:
            assert method.order == 4
            assert 0 <= min(method.c) <= max(method.c) <= 1
            assert method.b[1] >= 0.1
            assert method.a[2, 0] <= 0.3
        assert "b_2 in [0.1, inf]" in str(result)

    def test_weights_of_one_sign_exist_up_to_order_two(self):
        for shape in ({}, {"embedded": True}, {"rows": "diagonal"}):
            methods = search(2, 3, 20, 1, workers=1, nonnegative="b", **shape).methods
            assert methods
            assert min(method.b.min() for method in methods) >= 0
        assert not search(3, 5, 20, 1, workers=1, nonnegative="b", force=True).methods


@pytest.mark.parametrize(("order", "stages", "rows"), [
    (2, 2, "explicit"), (3, 4, "explicit"), (4, 6, "explicit"), (3, 3, "diagonal"), (3, 3, "full"),
])  # fmt: skip
def test_pairs_of_tableaux(order, stages, rows):
    methods = search(order, stages, 10, 1, workers=1, rows=rows, embedded=True).methods
    assert methods
    for method in methods:
        assert (method.order, method.embedded_order) == (order, order - 1)
        assert method.b_embedded[-1] == 0
        assert np.abs(residuals(method.a, method.b_embedded, order - 1)).max() < 1e-12
        assert np.abs(residuals(method.a, method.b_embedded, order)).max() > 1e-4


def largest(method):
    return max(abs(float(coefficient.value)) for coefficient in method.coefficients)


@pytest.mark.parametrize(("shape", "text"), [({}, "got w$"), ({"flows": 5}, "c or w of")])
def test_unknown_names_are_refused_with_the_argument(shape, text):
    name = "b[2]" if shape else "w"
    refuses(ValueError, f"nonnegative must .*{text}", search, 3, 4, 1, nonnegative=name, **shape)


@pytest.mark.parametrize("interval", [3, "ab", (1,), (1, 0), (1.0, np.inf), (None, "x")])
def test_intervals_are_named_as_they_were_given(interval):
    message = rf"bound: c_2 must have two increasing ends.* got {re.escape(repr(interval))}$"
    refuses(ValueError, message, search, 3, 4, 1, bound={"c[2]": interval})


@pytest.mark.parametrize(("options", "message"), [
    ({"width": 0}, "width must be finite and positive, got 0"),
    ({"flows": 5, "hold": {"c[2]": "1/2"}}, "with flows, got {'c_2': '1/2'}"),
])  # fmt: skip
def test_refused_arguments_are_shown_as_values(options, message):
    refuses(ValueError, message, search, 3, 4, 1, **options)


@pytest.mark.parametrize("pair", [False, True])
@pytest.mark.parametrize(("order", "stages"), [(1, 2), (3, 5), (4, 6)])
def test_jacobian_is_the_derivative(order, stages, pair):
    order = max(order, 2) if pair else order
    system = ConditionSystem(order, register_chain(stages, order, pair), registers=True)
    x = np.random.default_rng(order).uniform(0.2, 1.0, system.size)
    expected = jacobian(lambda s: system.residual(x + s), system.size, bound=1e-8)
    assert np.abs(system.jacobian(x) - expected).max() < 1e-8


@pytest.mark.parametrize(("order", "stages"), [(1, 1), (2, 2), (3, 3), (4, 5), (5, 11)])
def test_searches_find_methods_of_two_registers(order, stages):
    methods = cg.search(order, stages, 20, 1, workers=1, registers=True).methods
    assert methods
    for method in methods:
        assert (method.order, method.stages, method.exponentials) == (order, stages, stages)
        assert two_registers(method) is not None


@pytest.mark.parametrize(("order", "stages"), [(2, 3), (3, 4), (3, 5), (4, 7), (4, 8)])
def test_second_results_need_the_register_and_the_field_at_the_result(order, stages):
    methods = cg.search(order, stages, 12, 1, workers=1, registers=True, embedded=True).methods
    assert methods
    for method in methods:
        assert (method.order, method.embedded_order) == (order, order - 1)
        last, along, *field = method.points[method.result :]
        assert along.parent == (-1 if order < 4 else 1)
        ratios = [float(along.weights[k] / last.weights[k]) for k in last.weights]
        np.testing.assert_allclose(ratios, ratios[0], rtol=1e-13)
        if order < 4:
            assert method.stage_points[-1] == method.result == stages - 2
            assert set(field[0].weights) <= {stages - 1}
    assert order < 3 or min(map(estimate_ratio, methods)) < 2


@pytest.mark.parametrize(("changed", "name"), [
    ({"registers": 1}, "registers"), ({"tree": cg.methods["CF4"]}, "registers"),
    ({"flows": 6}, "registers"), ({"hold": {"w[1,1]": 1}}, "registers"),
    ({"first_same_as_last": True}, "registers"), ({"algorithm": "lmdif"}, "registers"),
    ({"stages": 4}, "two registers"), ({"stages": 1, "embedded": True}, "stages"),
    ({"rows": "full"}, "rows"), ({"nonnegative": "w"}, "nonnegative"),
])  # fmt: skip
def test_bad_arguments_are_named(changed, name):
    arguments = {"order": 4, "stages": 6, "registers": True} | changed
    refuses((TypeError, ValueError), rf"\b{name}\b", cg.search, **arguments)


SHAPES = {
    "explicit": ({"order": 3, "stages": 4, "starts": 20}, Layout.tableau(4)),
    "diagonal": (
        {"order": 3, "stages": 3, "rows": "diagonal", "starts": 20},
        Layout.tableau(3, "diagonal"),
    ),
    "tree": (
        {"order": 3, "stages": 4, "tree": cg.methods["CF4"], "starts": 40},
        cg.methods["CF4"].layout,
    ),
}


def random_hold(layout, random):
    """Return a coefficient and an abscissa with random values."""
    name = layout.names[random.integers(layout.size)].replace("_", "[", 1) + "]"
    stage = int(random.integers(2, layout.stages + 1))
    value, c = (f"{random.integers(1, 7)}/{random.integers(3, 9)}" for _ in range(2))
    return {name: value} | ({f"c[{stage}]": c} if len(layout.row(stage - 1)) > 1 else {})


def assert_held(method, hold, exactly=True):
    x, layout = [entry.value for entry in method.coefficients], method.layout
    rows = {name: [k] for k, name in enumerate(layout.names)}
    rows |= {f"c_{r + 1}": layout.row(r) for r in range(layout.stages)}
    for name, value in read_hold(hold):
        off = abs(sum(x[k] for k in rows[name]) - Fraction(value))
        assert off == 0 if name[0] != "c" and exactly else off < Fraction(1, 10**33), name


@pytest.mark.parametrize("shape", SHAPES)
def test_methods_keep_held_values(shape):
    arguments, layout = SHAPES[shape]
    random, solved = np.random.default_rng(7), 0
    for _ in range(6):
        hold = random_hold(layout, random)
        for method in cg.search(**arguments, seed=3, hold=hold).methods[:3]:
            assert method.exact_order >= 3
            assert_held(method, hold)
            solved += 1
    assert solved >= 6


def test_construct_keeps_held_values_and_the_interval_of_abscissae():
    hold = {"c[3]": "1/2", "b[2]": 0, "a[2,1]": "1/3"}
    assert_held(cg.construct(4, 6, seed=1, hold=hold).method, hold)
    assert_held(
        cg.construct(5, 10, 1, hold=hold, structure=cg.Structure.STAGE_ORDER_TWO).method, hold
    )
    hold = {"c[2]": "1/3"}
    assert_held(cg.construct(3, 4, seed=1, tree=cg.methods["CF4"], hold=hold).method, hold)
    for shape in ({}, {"flows": 6}):
        method = cg.construct(4, 5, seed=1, abscissae=(0, 0.95), **shape).method
        assert method.c.min() >= 0
        assert method.c.max() <= 0.95
        best = cg.construct(4, 5, seed=1, minimise="principal_error", **shape).method
        assert best.principal_error < 0.9 * method.principal_error


@pytest.mark.parametrize(("hold", "message"), [
    (3, "mapping"),
    ({1: 2}, "mapping"),
    ({"a[1,2]": 1}, "got a_1,2$"),
    ({"b[1]": "x"}, "b\\[1\\]: expected a finite real number"),
    ({"b[1]": 1, "b_1": 2}, "one value"),
    ({"c[1]": 1}, "c_1 = 1 contradicts"),
    ({"c[3]": 1, "a[3,1]": 1, "a[3,2]": 1}, "contradicts"),
    ({"a[2,1]": 1, "a[3,1]": 1, "a[4,1]": 1}, "12 unknowns for 13 independent"),
])  # fmt: skip
def test_impossible_values_are_refused(hold, message):
    refuses((TypeError, ValueError), f"hold.*{message}", cg.search, 4, 5, hold=hold)


FIVE = {"order": 5, "stages": 6, "seed": 1}


@pytest.fixture(scope="module")
def search_of_drawn_trees():
    return cg.search(**FIVE, starts=60, flows=9, workers=2)


def test_drawn_trees_lead_to_methods_of_the_order(search_of_drawn_trees):
    assert search_of_drawn_trees.methods
    assert len({m.layout.parents for m in search_of_drawn_trees.methods}) > 1
    for method in search_of_drawn_trees.methods:
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
    fewer = Reduction(np.random.default_rng(1), max_coefficient=10.0).drop_flow(candidate)
    assert solved(fewer)
    assert (fewer.system.stages, len(fewer.system.layout.parents)) == (6, 8)
