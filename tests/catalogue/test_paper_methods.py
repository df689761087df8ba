"""CG4, CG4a, CG5a and CG6a against closed forms, printed coefficients and known properties."""

from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from refusals import refuses

from cg import conditions
from cg.construction.catalogue import methods
from cg.reproduce.coefficients import compare, nearest_exact, printed

UNIT = Fraction(1, 10**16)
REFINED = ["CG4a", "CG5a"]


class TestPublishedCoefficients:
    @pytest.mark.parametrize("name", REFINED)
    def test_catalogue_agrees(self, name):
        for label, digits, value in compare(name):
            assert abs(value - Fraction(digits)) <= 2 * UNIT, label
            assert Fraction(digits) != 0 or value == 0, label

    def test_cg4a_is_an_exact_method_rounded_not_truncated(self):
        assert nearest_exact("CG4a", truncated=False) < 0.4
        assert nearest_exact("CG4a", truncated=True) > 0.6
        assert all(abs(value - Fraction(text)) < UNIT / 2 for _, text, value in compare("CG4a"))

    @pytest.mark.parametrize("name", REFINED)
    @pytest.mark.parametrize("rounding", [ROUND_DOWN, ROUND_HALF_EVEN])
    def test_truncation_is_detected(self, name, rounding):
        """Rounded and truncated digits of an exact method are recognised."""
        texts = [
            str(Decimal(entry.text).quantize(Decimal("1e-16"), rounding))
            for entry in methods[name].coefficients
        ]
        cut = methods[name].with_coefficients(texts)
        assert nearest_exact(name, cut, truncated=rounding == ROUND_DOWN) <= 0.5

    def test_cg6a_equals_the_printed_coefficients(self):
        for label, digits, value in compare("CG6a"):
            bound = Fraction(2, 10**8) if label[0] == "c" else 0
            assert abs(value - Fraction(digits)) <= bound
        texts = [entry.text for entry in methods["CG6a"].weights]
        assert texts == list(printed()["CG6a"].b)

    def test_c5_determines_the_last_digits_of_a54(self):
        # many codes carry ...3565
        assert methods["CG4a"].entries[4][3].text.startswith("-1.10929793921134")
        paper = printed()["CG4a"]
        assert paper.a[4][3] == "-1.1092979392113465"
        assert sum(map(Fraction, paper.a[4])) == Fraction(paper.c[4])

    def test_comparing_with_another_method(self):
        refuses(ValueError, "must have 9 stages, got 5", compare, "CG5a", methods["CG4a"])
        with pytest.raises(KeyError):
            compare("CG4")
        compared = compare("CG4a", methods["CG4"])
        assert max(abs(value - Fraction(digits)) for _, digits, value in compared) > 10**15 * UNIT


class TestResiduals:
    @pytest.mark.parametrize("name", REFINED)
    def test_printed_coefficients_have_residuals_of_16_places(self, name):
        paper = printed()[name]
        stages = len(paper.b)
        a = [[*row, *["0"] * (stages - len(row))] for row in paper.a]
        residuals = conditions.residuals(a, paper.b, methods[name].order, arithmetic="exact")
        assert UNIT / 100 < max(map(abs, residuals)) < 2 * UNIT

    def test_cg6a_is_approximate(self):
        method = methods["CG6a"]
        assert method.approximate
        assert method.order == 6
        assert method.exact_order == 1  # 8 places allow 2.4e-7 a condition of order two, not 6e-7
        residuals = conditions.residuals(method.a, method.b, 6)
        assert 8e-6 < np.abs(residuals).max() < 9e-6
        assert 1e-9 < residuals @ residuals < 1.1e-9  # the paper: about 1e-8
        assert method.principal_error > 1000 * np.abs(residuals).max()


def test_cg4_is_its_closed_form():
    with localcontext(prec=50):
        root = Decimal(2) ** (Decimal(1) / 3)
        assert abs(root**3 - 2) < Decimal("1e-48")
        t1, t2 = 1 + root + root**2, root + root**2
        t3, t4 = 2 * root + root**2, 4 + 3 * root + 2 * root**2
        theta = (t1 + (105 + 88 * root + 71 * root**2).sqrt()) / 18
        last = 10 + 8 * root + 7 * root**2
        expected = {
            (3, 2): t4 / 18, (4, 2): t1 * theta - t4 / 18,
            (4, 3): (3 + t2 - 9 * t1 * theta) / (4 + t3), (5, 2): theta,
            (5, 3): (3 + 2 * t2 - 9 * t1 * theta) / last, (5, 4): -t2 / (4 + t3),
        }  # fmt: skip
        weights = [t1 / (2 * t2), 0, -(1 + t3) / (6 * (2 + t2)), -1 / (2 * t2), t1 / (2 * t2)]
        c3 = root / 3 + root**2 / 6 + Decimal(2) / 3
        abscissae = [0, Decimal(3) / 2, c3, 1 - c3, 1]
    a, b = methods["CG4"].exact
    for (i, j), value in expected.items():
        assert abs(a[i - 1][j - 1] - Fraction(value)) < Fraction(1, 10**35)
    for entry, value in zip(b, weights, strict=True):
        assert abs(entry - Fraction(value)) < Fraction(1, 10**35)
    for row, value in zip(a, abscissae, strict=True):
        assert abs(sum(row) - Fraction(value)) < Fraction(1, 10**34)
