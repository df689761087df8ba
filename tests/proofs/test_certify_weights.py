import math
from fractions import Fraction

import numpy as np
import pytest
from flint import arb
from hypothesis import given, settings
from strategies import tableaux

import cg
from cg import conditions
from cg.catalogue import methods
from cg.conditions import Rows
from cg.proofs import certify
from cg.proofs.dependent.composition import MidpointSteps, convolve, logarithm
from cg.proofs.dependent.identities import MiddleAbscissae, StageOrderTwo
from cg.proofs.dependent.path import PathStructure
from cg.proofs.dependent.words import (
    condition_words,
    nodes,
    parse,
    reciprocal_density,
    shuffle,
    text,
)
from cg.proofs.krawczyk import to_double
from cg.proofs.statement import Packed
from cg.proofs.systems import EquationSystem, exact_residuals, order_system
from cg.proofs.weights import Quantity, Weights
from cg.structure.layout import Layout
from cg.support.balls import to_ball
from cg.support.balls import working_precision as precision

pytestmark = pytest.mark.no_core


class TestWords:
    def test_counts_and_densities(self):
        assert [len(condition_words(q)) for q in range(1, 7)] == [1, 2, 5, 13, 38, 113]
        for q in (3, 5):
            actual = tuple(
                reciprocal_density(word) for word in condition_words(q, independent=False)
            )
            assert actual == conditions.right_sides(q)

    def test_text(self):
        for word in condition_words(5):
            assert parse(text(word)) == word
        assert text((1, ((), 0))) == "[(2)[[](1)]]"

    def test_weights_multiply_by_shuffles(self):
        words = condition_words(3, independent=False)
        for u in words:
            for v in words:
                product = sum(n * reciprocal_density(w) for w, n in shuffle(u, v).items())
                assert product == reciprocal_density(u) * reciprocal_density(v)


class TestBalls:
    @settings(deadline=None, max_examples=30)
    @given(tableaux())
    def test_rational_weights_agree_with_the_oracle(self, tableau):
        a, b = tableau
        rows = conditions.rows_of(a)
        lengths = Layout.tableau(len(b), rows).lengths
        x = [v for row, n in zip([*a, b], lengths, strict=True) for v in row[:n]]
        layout = Layout.tableau(len(b), rows)
        residuals = exact_residuals(layout, x, condition_words(4), len(b))
        assert tuple(residuals) == conditions.residuals_exact(a, b, 4, independent=True)

    @pytest.mark.parametrize("rows", Rows)
    def test_derivatives_agree_with_the_compiled_core(self, rows):
        layout = Layout.tableau(4, rows)
        x = np.random.default_rng(5).uniform(-1, 1, layout.size)
        actual = to_double(order_system(layout, 5, None).linearise([arb(v) for v in x])[1])
        a, b = (np.array(part, float) for part in conditions.unpack(x, 4, rows))
        expected = conditions.jacobian(a, b, 5, independent=True, rows=rows)
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13)

    def test_parts_of_rows_and_marks(self):
        a, b = methods["CG3"].exact
        layout = Layout.tableau(3, Rows.EXPLICIT)
        x = [*a[1][:1], *a[2][:2], *b]
        residuals = exact_residuals(layout, x, [((1,),), (1, ())], 3)
        assert residuals == [b[2] * a[2][1], b[1] * (b[1] / 2 + b[2])]
        with precision(200):
            balls = Packed.of(methods["CG3"]).balls()
            quantities = [Quantity(3, ((),), 2), Quantity(3, ((), ()), 2), Quantity(2, ((),), 1)]
            values = Weights(layout, quantities).evaluate(balls)
            part = b[0] + b[1]
            for value, exact in zip(values, [part, part**2 / 2, a[2][0]], strict=True):
                assert abs(float(value) - float(exact)) < 1e-15

    def test_derivatives_of_parts_by_differences(self):
        layout = Layout.tableau(4, Rows.EXPLICIT)
        quantities = [
            Quantity(4, ((), ((),)), 3),
            Quantity(4, ((2,), ())),
            Quantity(3, (((),), ())),
            Quantity(4, ((), 1)),
        ]
        x = np.random.default_rng(8).uniform(-1, 1, layout.size)
        with precision(200):
            weights = Weights(layout, quantities)
            at = weights.evaluate([arb(v) for v in x])
            jac = to_double(weights.jacobian())
            for k in range(layout.size):
                step = [arb(v) + (arb(2) ** -60 if i == k else 0) for i, v in enumerate(x)]
                moved = Weights(layout, quantities).evaluate(step)
                slope = [float((m - v) * arb(2) ** 60) for m, v in zip(moved, at, strict=True)]
                np.testing.assert_allclose(jac[:, k], slope, atol=1e-12)


def exact_weights(a, b, words):
    """Return Φ(w) for words with marks, as Fractions."""
    rows = conditions.rows_of(a)
    lengths = Layout.tableau(len(b), rows).lengths
    x = [v for row, n in zip([*a, b], lengths, strict=True) for v in row[:n]]
    residuals = exact_residuals(Layout.tableau(len(b), rows), x, words, len(b))
    return {w: value + reciprocal_density(w) for w, value in zip(words, residuals, strict=True)}


def combined(relation, weights):
    return sum((c * weights[word] for word, c in relation.items()), Fraction(0))


def explicit_rows(stages, draw):
    return [[draw() if j < i else Fraction(0) for j in range(stages)] for i in range(stages)]


class TestIdentities:
    """Tableaux with rational coefficients that satisfy an identity, and no order conditions."""

    @pytest.fixture
    def draw(self):
        rng = np.random.default_rng(12)
        return lambda: Fraction(int(rng.integers(1, 40)), int(rng.integers(7, 20)))

    def relations(self, identity, grade):
        plain = [w for w in condition_words(grade, independent=False) if nodes(w) == grade]
        return [relation for word in plain for relation in identity.relations(word)]

    def check(self, identity, a, b, grades):
        layout = Layout.tableau(len(b), conditions.rows_of(a))
        for grade in grades:
            relations = self.relations(identity, grade)
            assert relations
            for relation in relations:
                weights = exact_weights(a, b, list(relation))
                assert combined(relation, weights) == 0
                densities = {word: reciprocal_density(word) for word in relation}
                assert combined(relation, densities) == 0
        x = [v for row, n in zip([*a, b], layout.lengths, strict=True) for v in row[:n]]
        zeros = [frozenset(k for k, weight in enumerate(b) if weight == 0)]
        system = EquationSystem(layout, tuple(identity.equations(layout, zeros)))
        with precision(200):
            values = system.residuals(list(map(to_ball, x)))
            assert len(values) >= len(b) - 2
            assert all(abs(value) < 1e-40 for value in values)

    @pytest.mark.parametrize("weight", [Fraction(0), Fraction(2, 3)])
    def test_path(self, draw, weight):
        a, b = explicit_rows(5, draw), [draw() for _ in range(5)]
        b[3] = weight
        mu = Fraction(3, 7)
        b[0] = a[1][0] / 2 - a[1][0] / (2 * mu)
        c = [sum(row) for row in a]
        for k in range(2, 5):
            c[k] = sum(a[k])
            sums = sum(b[j] * (c[k] - c[j]) for j in range(k))
            expected = c[k] ** 2 / 2 + mu * (sums - c[k] ** 2 / 2)
            if b[k]:  # move between a_k1 and a_k2: c_1 = 0, so that c_k stays
                change = (expected - sum(x * y for x, y in zip(a[k], c, strict=True))) / c[1]
                a[k][1] += change
                a[k][0] -= change
        layout = Layout.tableau(5)
        x = layout.packed([*a, b])
        with precision(200):
            path = PathStructure(layout, [5], x)
            assert path.satisfied()
            assert not PathStructure(layout, [5], x, infinite=True).satisfied()
            assert not PathStructure(layout, [5], [*x[:-5], x[-5] + 1, *x[-4:]]).satisfied()
            balls = list(map(to_ball, x))
            words = condition_words(5, independent=False)
            actual = Weights(layout, [Quantity(5, word) for word in words]).evaluate(balls)
            weights = dict(zip(words, actual, strict=True))
            relations = [{w: c for (_, w), c in one.items()} for one in path.relations(balls)]
            assert {word for one in relations for word in one} >= {((), ((),), ()), (((), ((),)),)}
            for relation in relations:
                assert abs(sum(c * weights[w] for w, c in relation.items())) < 1e-50
                exact = sum(c * to_ball(reciprocal_density(w)) for w, c in relation.items())
                assert abs(exact) < 1e-50

    @pytest.mark.parametrize("weight", [Fraction(0), Fraction(2, 3)])
    def test_middle_abscissae(self, draw, weight):
        a, b = explicit_rows(5, draw), [Fraction(0), *(draw() for _ in range(4))]
        b[3] = weight
        for k in range(1, 5):
            if b[k]:
                a[k][0] += sum(b[:k]) + b[k] / 2 - sum(a[k])
        self.check(MiddleAbscissae(), a, b, [2, 3, 4, 5, 6])

    def test_a_first_stage_with_a_weight_is_not_in_the_middle(self):
        # c_1 = 0: the equation there says b_1 = 0, which isn't left out
        layout = Layout.tableau(2, Rows.EXPLICIT)
        equations = MiddleAbscissae().equations(layout, [frozenset()])
        system = EquationSystem(layout, tuple(equations))
        values = system.residuals([arb(1) / 3, arb(1) / 4, arb(1) / 6])
        assert [abs(value) < 1e-10 for value in values] == [False, True]

    def test_stage_order_two(self, draw):
        a, b = explicit_rows(5, draw), [draw() for _ in range(5)]
        c = [sum(row) for row in a]
        for k in range(2, 5):
            change = (c[k] ** 2 / 2 - sum(x * y for x, y in zip(a[k], c, strict=True))) / c[1]
            a[k][1] += change
            a[k][0] -= change
        kappa = -(c[1] ** 2) / 2
        for grade in (3, 4, 5):
            for relation in self.relations(StageOrderTwo(1), grade):
                weights = exact_weights(a, b, list(relation))
                marked = [word for word in relation if "(2)" in text(word)]
                if marked:  # others differ by a multiple of a shorter word with a mark
                    weights[marked[0]] *= kappa
                    assert combined(relation, weights) == 0

    @pytest.mark.parametrize("letter", [((), ()), ((),) * 3, (((),),), ((), ((),)), 1])
    def test_letters_before_a_mark_are_multiples_of_a_smaller_one(self, draw, letter):
        # a mark is one on stage 2; the factor is then that of the letters there
        a, b = explicit_rows(5, draw), [draw() for _ in range(5)]
        c = a[1][0]
        value = 1 if letter == 1 else c ** len(letter) / math.factorial(len(letter))
        factor = value / c if letter == 1 or set(letter) == {()} else 0
        row, smaller = (letter, (), 1, ((),)), (((),), (), 1, ((),))
        assert {(row,): 1} in list(StageOrderTwo(1).relations((row,)))
        assert {(smaller,): 1} not in list(StageOrderTwo(1).relations((smaller,)))
        for outer in ((row,), (((), row), ())):
            reduced = (smaller,) if outer == (row,) else (((), smaller), ())
            weights = exact_weights(a, b, [outer, reduced])
            assert weights[reduced] != 0
            assert weights[outer] == factor * weights[reduced]

    def test_letters_after_a_mark_are_not(self, draw):
        row = (1, ((), ()))
        assert {(row,): 1} not in list(StageOrderTwo(1).relations((row,)))

    def test_all_conditions_follow(self):
        # 60 digits of a zero of 36 equations, which imply all 64 conditions
        method = methods["CG5a"]
        a, b = method.digits(60)
        residuals = conditions.residuals_exact(a, b, 5)
        assert len(residuals) == 64
        assert max(map(abs, residuals)) < Fraction(1, 10**58)


class TestComposition:
    def test_the_exact_flow_is_the_exponential_of_its_first_part(self):
        words = condition_words(5, independent=False)
        exact = {(): Fraction(1), **{word: reciprocal_density(word) for word in words}}
        assert logarithm(exact, words) == {((),): 1}

    def test_midpoint_steps_have_odd_logarithms(self):
        words = condition_words(4, independent=False)
        residuals = exact_residuals(Layout.tableau(1, Rows.DIAGONAL), [Fraction(1, 2), 1], words, 1)
        step = {w: v + reciprocal_density(w) for w, v in zip(words, residuals, strict=True)}
        assert {nodes(w) for w in logarithm({(): Fraction(1), **step}, words)} == {1, 3}

    def test_convolution_is_composition(self):
        # an Euler step, then one of CG2, as one tableau: rows begin with what came before
        words = condition_words(4, independent=False)
        euler = exact_weights([[Fraction(0)]], [Fraction(1, 3)], words)
        two = exact_weights([[0, 0], [Fraction(1, 2), 0]], [Fraction(0), Fraction(1)], words)
        third, half = Fraction(1, 3), Fraction(1, 2)
        a = [[0, 0, 0], [third, 0, 0], [third, half, 0]]
        both = exact_weights(a, [third, Fraction(0), Fraction(1)], words)
        one = {(): Fraction(1)}
        product = convolve(one | euler, one | two, words)
        assert product == {word: value for word, value in both.items() if value}

    @pytest.mark.parametrize("grade", range(2, 6))
    def test_relations_of_symmetric_midpoint_steps(self, grade):
        # of order four: residuals with five nodes aren't zero, but related
        a, b = cg.methods["DICG4"].digits(60, certificate=certify("DICG4"))
        residuals = conditions.residuals_exact(a, b, 5)
        words = condition_words(5, independent=False)
        by_word = dict(zip(words, residuals, strict=True))
        plain = [w for w in words if nodes(w) == grade]
        for word in plain:
            for relation in MidpointSteps().relations(word):
                total = sum(by_word[w] * v for w, v in relation.items())
                assert abs(total) < Fraction(1, 10**55)
        assert (max(abs(by_word[w]) for w in plain) > Fraction(1, 100)) == (grade == 5)
