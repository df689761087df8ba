"""Order conditions of trees of points: exact, compiled, and in balls."""

from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from coefficients import CF3, floats, values
from exact import word_residuals
from flint import arb
from hypothesis import example, given, settings
from hypothesis import strategies as st
from quotients import jacobian
from refusals import refuses
from strategies import point_trees, rationals, tableaux

from cg import CommutatorFree, conditions
from cg.construction.catalogue import methods
from cg.construction.conditions.exact import (
    EquationSystem,
    Quantity,
    Weights,
    condition_words,
    conditions_of,
)
from cg.construction.layouts import Layout
from cg.construction.points import MethodError, Point, PointTree, tree_of_rows
from cg.construction.proofs.krawczyk import doubles
from cg.support.quads import to_flint
from research.impossibility.weights import exact_weights

exactly = partial(conditions.residuals, arithmetic="exact")


@pytest.mark.parametrize("arithmetic", ["double", "exact"])
def test_residuals_refuse_what_has_other_conditions(arithmetic):
    for name in ("Magnus8(4)", "CFM6(4)", "RKMK4", "Leapfrog"):
        with pytest.raises(TypeError, match="a has other conditions, see its method residuals"):
            conditions.residuals(methods[name], 3, arithmetic=arithmetic)
    with pytest.raises(TypeError, match="a must be a method unless b and order are given"):
        conditions.residuals("CG3", 3, arithmetic=arithmetic)


@pytest.mark.parametrize("arithmetic", ["double", "exact"])
@pytest.mark.parametrize(("parent", "stage", "at", "end"), [
    (-1, 7, -1, 0), (-1, -1, -1, 0), (0, 0, -1, 0), (-2, 0, -1, 0), (-1, 0, 1, 0), (-1, 0, -1, 5),
])  # fmt: skip
def test_residuals_refuse_places_that_there_are_not(parent, stage, at, end, arithmetic):
    tree = PointTree((Point(parent, {stage: Fraction(1)}),), (at,), end)
    layout = Layout((parent,), ((stage,),), (at,), (end,))
    for arguments in ((tree, 2), (layout, [1.0], 2)):
        with pytest.raises(MethodError, match="points must lead from earlier ones"):
            conditions.residuals(*arguments, arithmetic=arithmetic)


class TestResiduals:
    @settings(deadline=None, max_examples=40)
    @given(tableaux(rationals))
    def test_tableau_equals_its_points(self, tableau):
        a, b = tableau
        tree = tree_of_rows(a, b)
        assert exactly(tree, 4) == exactly(a, b, 4)
        packed = conditions.residuals(a, b, 4)
        sizes = 1 + conditions.weights(np.abs(np.array(a, float)), np.abs(np.array(b, float)), 4)
        np.testing.assert_allclose(
            conditions.residuals(tree, 4), packed, rtol=0, atol=1e-14 * sizes.max()
        )

    @settings(deadline=None, max_examples=40)
    @example(methods["CF4"].tree, 5)  # a stage whose path begins where another's ends
    @given(point_trees(), st.integers(2, 5))
    def test_derivatives_are_exact_differences(self, tree, order):
        layout, x = Layout.of_tree(tree), floats(tree)
        jacobian = conditions.jacobian(layout, x, order, independent=True)
        step = Fraction(1, 2**40)  # the differences are exact, so that what they miss is step²
        for k in range(layout.size):
            ahead, behind = values(tree), values(tree)
            ahead[k] += step
            behind[k] -= step
            pairs = zip(
                exactly(moved(tree, ahead), order, independent=True),
                exactly(moved(tree, behind), order, independent=True),
                strict=True,
            )
            slopes = [float((one - other) / (2 * step)) for one, other in pairs]
            scale = 1 + np.abs(jacobian).max()
            np.testing.assert_allclose(jacobian[:, k], slopes, rtol=0, atol=1e-11 * scale)

    def test_the_second_result(self):
        tree = CommutatorFree(CF3, [-1, 0, 1], embedded_result=1).tree
        second = PointTree(tree.points, tree.stage_points, 1)
        for order in (1, 3):
            assert exactly(tree, order, embedded=True) == exactly(second, order)
            np.testing.assert_array_equal(
                conditions.residuals(tree, order, embedded=True),
                conditions.residuals(second, order),
            )
        refuses(ValueError, "without second", conditions.residuals, second, 1, embedded=True)


def moved(tree, weights):
    return Layout.of_tree(tree).tree(weights)


class TestBalls:
    @settings(deadline=None, max_examples=30)
    @given(point_trees(), st.integers(1, 4))
    def test_rationals_agree_with_the_oracle(self, tree, order):
        indices = conditions.condition_trees(order, independent=True)
        sides = conditions.right_sides(order, independent=True)
        weights = exact_weights(tree, order, indices, Fraction)
        expected = tuple(phi - side for phi, side in zip(weights, sides, strict=True))
        assert exactly(tree, order, independent=True) == expected

    @settings(deadline=None, max_examples=30)
    @given(point_trees(), st.integers(1, 5))
    def test_derivatives_agree_with_the_compiled_core(self, tree, order):
        layout, x = Layout.of_tree(tree), floats(tree)
        actual = doubles(
            EquationSystem(layout, tuple(conditions_of([order])))
            .linearise([arb(v) for v in x])[1]
            .tolist()
        )
        expected = conditions.jacobian(layout, x, order, independent=True)
        scale = 1 + np.abs(expected).max()
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13 * scale)

    @settings(deadline=None, max_examples=20)
    @given(point_trees(), st.integers(0, 2**32 - 1))
    def test_balls_contain_exact_values(self, tree, seed):
        layout = Layout.of_tree(tree)
        words = condition_words(4)
        quantities = [Quantity(layout.stages, word) for word in words]
        outer = Weights(layout, quantities).evaluate([arb(float(v), 1e-3) for v in values(tree)])
        steps = np.random.default_rng(seed).integers(-1000, 1001, layout.size)
        inside = [v + Fraction(int(s), 10**6) for v, s in zip(values(tree), steps, strict=True)]
        exact = word_residuals(layout, inside, words)
        middle = word_residuals(layout, values(tree), words)
        weights = Weights(layout, quantities).evaluate([to_flint(v) for v in values(tree)])
        for ball, value, there, here in zip(outer, exact, middle, weights, strict=True):
            assert ball.contains(here + to_flint(value - there))

    def test_derivatives_of_weights_at_stages(self):
        tree = methods["CF4b"].tree
        layout, x = methods["CF4b"].layout, floats(tree)
        quantities = [Quantity(k, ((), ((),))) for k in range(layout.stages)]
        quantities += [Quantity(4, ((), ())), Quantity(5, ((),)), Quantity(5, (((),), ()))]
        weights = Weights(layout, quantities)

        def at(s):
            return [float(v) for v in weights.evaluate([arb(v) for v in x + s])]

        expected = jacobian(at, layout.size, bound=1e-9)
        at(0 * x)
        actual = doubles(weights.jacobian().tolist())
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-9)
