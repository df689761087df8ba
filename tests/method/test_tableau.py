import re
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from refusals import refuses
from strategies import rationals, tableaux

from cg import conditions
from cg.construction.conditions import Rows
from cg.construction.layouts import rows_of
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.tableau import Tableau, TableauError

pytestmark = pytest.mark.no_core

MIDPOINT = Tableau([[], ["1/2"]], [0, 1], name="midpoint")


def decimal_euler(b):
    return Tableau([[]], [b])


class TestCoefficient:
    @pytest.mark.parametrize(("number", "value", "unit"), [
        ("119/216", Fraction(119, 216), 0), ("-3", Fraction(-3), 0), (7, Fraction(7), 0),
        (np.int64(7), Fraction(7), 0), (Fraction(1, 3), Fraction(1, 3), 0),
        ("0.25", Fraction(1, 4), 0), ("-.5", Fraction(-1, 2), 0), ("2.", Fraction(2), 0),
        ("0.0000000000", Fraction(0), 0), ("1e40", Fraction(10**40), 0),
        ("0.10465447", Fraction(10465447, 10**8), Fraction(1, 10**8)),
        ("-0.00388100", Fraction(-388100, 10**8), Fraction(1, 10**8)),
        ("1.5e-9", Fraction(15, 10**10), Fraction(1, 10**10)),
        (Decimal("0.123456789"), Fraction(123456789, 10**9), Fraction(1, 10**9)),
        (0.1, Fraction(0.1), Fraction(0.1) / 2**53),
        (np.float32(0.1), Fraction(float(np.float32(0.1))), None), (0.0, Fraction(0), 0),
    ])  # fmt: skip
    def test_value_and_unit(self, number, value, unit):
        read = Coefficient.read(number)
        assert read.value == value
        if unit is not None:
            assert read.unit == unit


class TestDerived:
    def test_explicit(self):
        method = Tableau([[0, 0, 0], ["3/4", 0, 0], ["119/216", "17/108", 0]], [1, 0, "-2/3"])
        assert method.stages == 3
        assert method.explicit
        assert method.rows is Rows.EXPLICIT
        assert method.exponentials == 5
        assert method.exact[0][2] == (Fraction(119, 216), Fraction(17, 108), 0)
        assert method.exact[1] == (1, 0, Fraction(-2, 3))
        np.testing.assert_array_equal(method.c, [0, 0.75, 153 / 216])
        assert method.a[2, 0] == 119 / 216
        assert method.b_embedded is None
        assert method.exact_embedded is None
        assert method.embedded is None
        assert method.embedded_order is None

    def test_implicit(self):
        midpoint = Tableau([["1/2"]], ["1"])
        assert not midpoint.explicit
        assert midpoint.rows is Rows.DIAGONAL
        assert midpoint.order == 2
        assert Tableau([[0, 1], [1, 0]], [1, 0]).rows is Rows.FULL

    @given(tableaux(rationals))
    def test_exponentials_share_first_parts_of_rows(self, tableau):
        method = Tableau(*tableau)
        assert method.rows is rows_of(tableau[0])
        rows = [[(j, w) for j, w in enumerate(row) if w] for row in (*method.exact[0], tableau[1])]
        if method.explicit:
            flows = len({tuple(row[:k]) for row in rows for k in range(1, len(row) + 1)})
        else:
            flows = sum(map(len, rows))
        assert method.exponentials == method.pair_exponentials == flows


class TestOrder:
    def test_rationals_have_no_tolerance(self):
        assert decimal_euler(1 - Fraction(1, 10**40)).order == 0

    def test_tolerance_of_decimals(self):
        assert decimal_euler("0.99999999").order == 1
        assert decimal_euler("0.99999997").order == 0
        assert decimal_euler("0." + "9" * 36).order == 1
        assert decimal_euler("0." + "9" * 32 + "0001").order == 0

    def test_tolerance_of_floats(self):
        b = [0.1] * 10
        method = Tableau(np.zeros((10, 10)), b)
        assert sum(method.exact[1]) != 1
        assert method.order == 1
        assert Tableau(np.zeros((10, 10)), [0.1] * 9 + [0.1 + 1e-14]).order == 0

    def test_sensitivity_counts(self):
        # b_2 a_21 = 1/2 holds with an error of a unit in a_21 that b_2 multiplies
        assert Tableau([[], ["0.00050001"]], [-999, 1000]).order == 2
        assert Tableau([[], ["0.00050003"]], [-999, 1000]).order == 1

    def test_principal_error(self):
        euler = decimal_euler(1)
        # of [[]] and [[]]: Φ = 0 and 1/2, so that only the first differs from 1/2
        assert euler.principal_error == pytest.approx(0.5)
        assert decimal_euler("1/2").principal_error == pytest.approx(0.5)
        exact = MIDPOINT.residuals(3)[conditions.count(2) :]
        assert MIDPOINT.principal_error == pytest.approx(float(sum(r * r for r in exact)) ** 0.5)
        last = conditions.MAX_ORDER
        highest = Tableau([[]], [1], nominal_order=last, nominal_residual=1)
        with pytest.raises(ValueError, match=f"order must be at most {last}, .* got {last + 1}"):
            _ = highest.principal_error


class TestNominalOrder:
    def make(self, **nominal):
        return Tableau([[], ["0.5001"]], [0, 1], **nominal)

    def test_attributes(self):
        method = self.make(nominal_order=2, nominal_residual="0.001")
        assert (method.order, method.exact_order, method.approximate) == (2, 1, True)
        assert not MIDPOINT.approximate

    def test_residuals_above_the_bound_are_refused(self):
        with pytest.raises(TableauError, match="residuals through nominal_order 2 reach"):
            self.make(nominal_order=2, nominal_residual="0.00001")
        with pytest.raises(TableauError, match="residuals through nominal_order 3 reach"):
            self.make(nominal_order=3, nominal_residual="0.001")


class TestPairs:
    def test_embedded(self):
        pair = Tableau([[], ["1/2"]], [0, 1], b_embedded=[1, 0], name="pair")
        assert (pair.order, pair.embedded_order) == (2, 1)
        assert pair.exact_embedded == (1, 0)
        np.testing.assert_array_equal(pair.b_embedded, [1, 0])
        assert pair.embedded == Tableau([[], ["1/2"]], [1, 0])
        assert pair != MIDPOINT


class TestBadInput:
    @pytest.mark.parametrize(("a", "b", "message"), [
        ([[]], [], "b must have at least one entry"),
        ([[0]], 1, "b must be a sequence of numbers, got 1"),
        (0, [1], "a must be a sequence of numbers, got 0"),
        ([0], [1], "row 1 of a must be a sequence of numbers, got 0"),
        ([[], "1"], [0, 1], "row 2 of a must be a sequence of numbers, got '1'"),
        ([], [1], "a must have 1 rows to match b"),
        ([[], [1], [1]], [1, 2, 3], "got lengths [0, 1, 1]"),
        ([[0, 0]], [1, 2], "a must have 2 rows to match b"),
        ([[], [1], [1, np.nan]], [1, 2, 3], "a_32: expected a finite real number, got nan"),
        ([[]], ["1e400"], "b_1: 1e400 is beyond the range of doubles"),
    ])  # fmt: skip
    def test_tableau(self, a, b, message):
        refuses(TableauError, re.escape(message), Tableau, a, b)

    def test_names(self):
        refuses(TableauError, "name must", Tableau, [[]], [1], name=3)
        refuses(TableauError, "source must", Tableau, [[]], [1], source=None)
