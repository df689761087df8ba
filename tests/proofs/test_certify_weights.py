import numpy as np
import pytest
from flint import arb

from cg import conditions
from cg.conditions import Rows
from cg.conditions.systems import EquationSystem
from cg.conditions.words import (
    condition_words,
    conditions_of,
    parse,
    reciprocal_density,
    text,
)
from cg.proofs.krawczyk import to_double
from cg.structure.layout import Layout

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


class TestBalls:
    @pytest.mark.parametrize("rows", Rows)
    def test_derivatives_agree_with_the_compiled_core(self, rows):
        layout = Layout.tableau(4, rows)
        x = np.random.default_rng(5).uniform(-1, 1, layout.size)
        actual = to_double(
            EquationSystem(layout, tuple(conditions_of([5]))).linearise([arb(v) for v in x])[1]
        )
        a, b = (np.array(part, float) for part in conditions.unpack(x, 4, rows))
        expected = conditions.jacobian(a, b, 5, independent=True, rows=rows)
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13)
