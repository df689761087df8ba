"""Methods as trees of points: attributes, text, rejected input."""

import pickle
from fractions import Fraction

import numpy as np
import pytest
from coefficients import CF3
from hypothesis import given, settings
from kinds import FROZEN
from refusals import refuses
from strategies import point_trees, rationals

import cg
from cg import CommutatorFree, MethodError, Tableau, conditions
from cg.construction.catalogue import dumps, loads, methods
from cg.construction.drawings import draw_points, draw_tree
from cg.construction.points import Point
from cg.construction.proofs import certify
from cg.construction.trees import OrderedTree


class TestMethods:
    def test_attributes(self):
        method = methods["CF4"]
        assert [point.parent for point in method.points] == [-1, -1, 0, -1, 3]
        assert method.points[2].weights == {0: Fraction(-1, 2), 2: 1}
        assert method.stage_points == (-1, 0, 1, 2)
        assert (method.result, method.embedded_result, method.embedded_order) == (4, None, None)
        assert (method.stages, method.exponentials, method.pair_exponentials) == (4, 5, 5)
        assert (method.order, method.exact_order, method.approximate) == (4, 4, False)
        assert method.explicit
        assert method.max_residual() == 0
        assert method.max_residual(5) > 1e-3
        assert method.principal_error > 1e-3
        assert repr(method) == "<CommutatorFree CF4: order 4, 4 evaluations, 5 flows>"

    def test_the_flat_tableau(self):
        a, b = methods["CF4"].exact
        half = Fraction(1, 2)
        assert a == ((0,) * 4, (half, 0, 0, 0), (0, half, 0, 0), (0, 0, 1, 0))
        assert b == (Fraction(1, 6), Fraction(1, 3), Fraction(1, 3), Fraction(1, 6))
        np.testing.assert_array_equal(methods["CF4"].c, [0, 0.5, 0.5, 1])
        np.testing.assert_array_equal(methods["CF4"].a, np.array(a, float))
        # two registers of lattice gauge theory: as a chain
        np.testing.assert_allclose(methods["CF3b"].c, [0, 1 / 4, 2 / 3], rtol=1e-15)
        np.testing.assert_allclose(methods["CF3b"].b, [1 / 4, 0, 3 / 4], rtol=0)

    def test_one_weight_per_point_equals_tableau(self):
        for name in ("CG4a", "CG6g", "CG7b"):
            tableau = methods[name]
            same = CommutatorFree(tableau.points, tableau.stage_points, tableau.result)
            assert same.exact == tableau.exact
            assert same.exponentials == tableau.exponentials
            np.testing.assert_array_equal(same.c, tableau.c)
            residuals = conditions.residuals(same, 4)
            np.testing.assert_allclose(residuals, 0, atol=1e-14)

    def test_pairs(self):
        points = [*CF3, (-1, {0: "1/4", 2: "3/4"})]
        pair = CommutatorFree(points, [-1, 0, 1], 2, embedded_result=3, name="mine")
        assert (pair.order, pair.embedded_order) == (3, 2)
        assert (pair.exponentials, pair.pair_exponentials) == (3, 4)
        assert pair.exact_embedded == (Fraction(1, 4), 0, Fraction(3, 4))
        np.testing.assert_array_equal(pair.b_embedded, [0.25, 0, 0.75])
        assert repr(pair) == "<CommutatorFree mine: order 3(2), 3 evaluations, 3 flows>"
        assert pair.embedded.exact[1] == pair.exact_embedded
        certificate = certify(pair)
        assert (certificate.order, certificate.embedded_order) == (3, 2)
        assert loads(dumps(pair)) == pair

    def test_implicit_tableaux_have_no_points(self):
        with pytest.raises(AttributeError, match="is implicit"):
            methods["DICG4"].points  # noqa: B018
        assert methods["DICG4"].exponentials == methods["DICG4"].pair_exponentials == 9

    @settings(deadline=None, max_examples=30)
    @given(point_trees(rationals))
    def test_file_round_trip(self, tree):
        points = [(point.parent, point.weights) for point in tree.points]
        method = CommutatorFree(points, tree.stage_points, tree.result, name="x", source="y")
        loaded = loads(dumps(method))
        assert loaded == method
        assert loaded.coefficients == method.coefficients


class TestBadInput:
    @pytest.mark.parametrize(("points", "stages", "options", "message"), [
        ([(0, {0: 1})], [-1], {}, "the parent of point 0 must come before it, or"),
        ([(5, {0: 1})], [-1], {}, "the parent of point 0 must be a point from -1 to 0,"),
        ([(-1, {0: 1})], [-1, 4], {}, "the point of stage 1 must be a point from -1 to 0"),
        ([(-1, {0: 1})], [0], {}, "the first stage must be at the initial point, -1, got 0"),
        ([(-1, {0: 1})], [], {}, "stage_points must have at least one entry"),
        ([(-1, {0: 1})], 3, {}, "stage_points must be a sequence, got 3"),
        ([(-1, {1: 1})], [-1], {}, "point 0 must have weights on earlier stages, of 0 to 0"),
        ([(-1, {1: 1})], [-1, 0], {}, "point 0 must have weights on earlier stages"),
        ([(-1, {0: 1}), (-1, {2: 1}), (1, {1: 1})], [-1, 1, 0], {}, "stage 1 must depend on"),
        ([(-1, {0: 0})], [-1], {}, "result must depend on a stage: no weights lead to point 0"),
        ([(-1, {0: 1})], [-1], {"result": 1}, "result must be a point from -1 to 0, got 1"),
        ([(-1, {0: 1})], [-1], {"embedded_result": 0}, "embedded_result must dif"),
        ([(-1, {0: 1}), (-1, {0: 1})], [-1], {"embedded_result": 0}, "embedded_result must"),
        ([(-1, {0: "x"})], [-1], {}, "weight of point 0 on stage 0: expected a finite real"),
        ([(-1, {0: "1e999"})], [-1], {}, "weight of point 0 on stage 0: 1e999 is beyond"),
        ([-1], [-1], {}, "point 0 must be a parent and a mapping from stages"),
        ([], [-1], {}, "points must have at least one entry, got none"),
        ({}, [-1], {}, "points must be a sequence, got {}"),
        ([(-1, {0: 1})], [-1], {"name": 5}, "name must be a str, got 5"),
        ([(-1, {0: 1})], [-1], {"nominal_order": 2, "nominal_residual": "0.1"}, "residuals"),
    ])  # fmt: skip
    def test_message_names_the_argument(self, points, stages, options, message):
        refuses(MethodError, f"^{message}", CommutatorFree, points, stages, **options)

    def test_points_must_be_tables(self):
        with pytest.raises(MethodError, match="points must"):
            loads('name = "x"\nsource = "y"\npoints = 3\nstage_points = [-1]\nresult = 0\n')


def faults(method):
    table = method.table()
    return table.converges, table.estimate_fault


@pytest.mark.parametrize("make", [
    lambda half: cg.Splitting([0, 1, 0], [half, half]),
    lambda half: cg.MagnusMethod([half], [[1]], [[half]], third=[half], third_factor=half),
    lambda half: cg.MagnusMethod([half], [[1, 0]], brackets=[([half], [1])]),
    lambda half: cg.MuntheKaas(
        Tableau([[], [1]], [1, 0], b_embedded=[0, 1]), third=[half, half]),
    lambda half: CommutatorFree(
        [(-1, {0: 1}), (-1, {1: 1})], [-1, 0], embedded_result=0, third=[half, half]),
])  # fmt: skip
def test_methods_of_equal_numbers_are_equal(make):
    one, other = make("1/2"), make("0.50")
    assert one == other != make("1/3")
    assert hash(one) == hash(other)


class TestFaults:
    """What integrations warn about."""

    def test_dormand_prince_tableau(self):
        pair = methods["RKMK5(4)"].tableau
        assert (pair.order, pair.embedded_order) == (2, 2)
        converges, fault = faults(pair)
        assert converges
        assert "both its results have order 2" in fault

    def test_third_results_of_low_order(self):
        """With 5(4, 1) the estimate has order 8, and 2e-8 is the error at a tolerance of 1e-10."""
        tableau = methods["RKMK5(4)"].tableau
        method = cg.MuntheKaas(tableau, third=["1/5", 0, "1/5", "1/5", "1/5", "1/5", 0])
        assert (method.third_order, method.table().exponent) == (1, 1 / 8)
        assert "third result has order 1" in faults(method)[1]
        assert not faults(methods["RKMK8(5,3)"])[1]

    def test_order_zero(self):
        half = Tableau([[]], ["1/2"], name="half")
        options = {"frame": cg.frames.Euclidean(1), "method": half, "h": 0.5}
        for call in (cg.integrate, cg.solve_ivp):
            with pytest.warns(UserWarning, match="half has order 0: its solutions don't") as caught:
                call(lambda t, y: [1.0], (0, 1), [0.0], **options)
            assert caught[0].filename == __file__
        pair = Tableau([[], ["1/2"]], [0, 1], b_embedded=["1/2", 0])
        assert "its second result has order 0" in faults(pair)[1]

    @pytest.mark.parametrize("name", list(FROZEN))
    def test_none_in_the_catalogue(self, name):
        assert faults(methods[name]) == (True, "")


def test_points_compare_by_value():
    one = Point(-1, {1: Fraction(1, 2), 0: Fraction(0)})
    assert one == Point(-1, {1: Fraction(1, 2)})
    assert hash(one) == hash(Point(-1, {1: Fraction(1, 2)}))
    assert one != Point(0, one.weights)
    assert pickle.loads(pickle.dumps(one)) == one
    assert repr(one) == "Point(-1, {1: 1/2})"
    with pytest.raises(TypeError):
        one.weights[0] = 1


class TestThirdWeights:
    def test_error_weights(self):
        third = ["1", *["0"] * 8]
        pair = methods["CF6(5)"].with_coefficients(methods["CF6(5)"].coefficients, third=third)
        second, weights = pair.error_weights
        assert second == tuple(
            b - w for b, w in zip(pair.exact[1], pair.exact_embedded, strict=True)
        )
        assert weights == tuple(b - (k == 0) for k, b in enumerate(pair.exact[1]))
        assert pair.third_order == 1
        assert pair != methods["CF6(5)"]
        assert pair.pair_exponentials == methods["CF6(5)"].pair_exponentials + 1
        again = loads(dumps(pair))
        assert again == pair
        assert hash(again) == hash(pair)
        assert again.third_weights == pair.third_weights
        assert methods["CF6(5)"].third_order is None


def test_drawings():
    assert draw_tree(OrderedTree.parse("[[[]][]]")) == "●\n├── ●\n│   └── ●\n└── ●"
    assert draw_points(methods["LieEuler"]) == "start: stage 1\n└── point 1: 1 F1; result"
    pair = draw_points(methods["CF4(3)"], digits=3)
    assert pair.count("second result") == 1
    assert pair.count("point") == len(methods["CF4(3)"].points)
    refuses(TypeError, "tree must", draw_tree, "[]")
