"""Methods of two registers: their form, their steps, and their order on manifolds."""

from fractions import Fraction

import pytest

import cg
from cg import MethodError
from cg.catalogue import dumps, loads, methods
from cg.low_storage import from_two_registers, two_registers
from cg.points import Point
from cg.quad import to_decimal

WILLIAMSON = ["0", "-5/9", "-153/128"], ["1/3", "15/16", "8/15"]
NAMES = [name for name, method in methods.items() if two_registers(method)]


class TestForm:
    def test_exact_in_and_exact_out(self):
        method = from_two_registers(*WILLIAMSON, name="W", source="Williamson")
        assert (method.name, method.source) == ("W", "Williamson")
        assert method.order == 3
        assert method.points[2] == Point(
            1, {0: Fraction(17, 48), 1: Fraction(-51, 80), 2: Fraction(8, 15)}
        )
        assert method.stage_points == (-1, 0, 1)
        found = two_registers(method)
        assert found == tuple(tuple(map(Fraction, row)) for row in WILLIAMSON)
        assert all(coefficient.unit == 0 for coefficient in method.coefficients)

    def test_the_one_of_lattice_gauge_theory(self):
        a, b = two_registers(methods["CF3b"])
        assert a == (0, Fraction(-17, 32), Fraction(-32, 27))
        assert b == (Fraction(1, 4), Fraction(8, 9), Fraction(3, 4))
        assert from_two_registers(a, b) == methods["CF3b"]

    def test_to_its_digits(self):
        a, b = two_registers(methods["CF4b"])
        printed = Fraction(-567301805773, 1357537059087), Fraction(2277821191437, 14882151754819)
        assert abs(a[1] - printed[0]) < 1e-24
        assert abs(b[4] - printed[1]) < 1e-24
        again = from_two_registers(*[[to_decimal(x, 36) for x in row] for row in (a, b)])
        assert again.order == 4
        assert two_registers(again) is not None

    def test_another_weight_is_seen_in_the_last_places(self):
        text = dumps(methods["CF4b"])
        old = '"-0.469079580103165879125419671308191663"'
        assert old in text
        assert two_registers(loads(text.replace(old, old.replace("191663", "195663")))) is None
        assert two_registers(loads(text.replace(old, old.replace("191663", "191664")))) is not None

    def test_decimals_keep_the_places_that_they_leave(self):
        a = ["0", "-0.4801594388478", "-1.4042471952", "-2.016477077503", "-1.056444269767"]
        b = [
            "0.1028639988105",
            "0.7408540575767",
            "0.7426530946684",
            "0.4694937902358",
            "0.1881733382888",
        ]
        method = from_two_registers(a, b)
        assert method.order == 4
        exact = from_two_registers(list(map(Fraction, a)), list(map(Fraction, b)))
        assert exact.order == 0
        for rounded, weight in zip(method.coefficients, exact.coefficients, strict=True):
            assert abs(rounded.value - weight.value) <= rounded.unit
            assert 0 < rounded.unit <= Fraction(1, 10**9)
        assert two_registers(method) is not None

    def test_others_have_no_registers(self):
        assert {"CF3b", "CF4b", "LieEuler"} <= set(NAMES)
        assert not {"CF3", "CF4", "CG3", "CG4(3)", "ImplicitMidpoint", "CG2"} & set(NAMES)

    def test_a_pair_needs_more(self):
        a, b = two_registers(methods["CF3b"])
        chain = from_two_registers(a, b)
        points = [*chain.points, (-1, {0: "1/3", 1: "2/3"})]
        pair = cg.CommutatorFree(points, chain.stage_points, 2, embedded_result=3)
        assert two_registers(pair) is None

    @pytest.mark.parametrize(
        ("a", "b", "words"),
        [
            ([0, 1], [1], "same length"),
            ([], [], "at least 1"),
            (["1/2"], [1], r"a\[0\] must be 0.*1/2"),
            ([0, 1], [1, 0], r"b\[1\] must not be 0"),
            ([0, "x"], [1, 1], r"a\[1\]"),
            ([0, 1], [1, float("nan")], r"b\[1\]"),
            ("01", [1, 1], "a must be a sequence"),
            ([0], 1, "b must be a sequence"),
        ],
    )
    def test_bad_input(self, a, b, words):
        with pytest.raises(MethodError, match=words):
            from_two_registers(a, b)
