"""Methods of two registers: their form, their steps, and their order on manifolds."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from compiled_examples import PROBLEMS
from kinds import FROZEN
from other_paths import without_registers
from refusals import refuses

from cg import MethodError
from cg.construction.catalogue import methods
from cg.construction.methods.low_storage import from_two_registers, two_registers
from cg.construction.methods.paths import paths_of
from cg.construction.points import Point
from cg.integration import integrate
from cg.support.quads import to_decimal

pytestmark = pytest.mark.sanitize

TOOL = "research/low_storage"
WILLIAMSON = ["0", "-5/9", "-153/128"], ["1/3", "15/16", "8/15"]
NAMES = [name for name, method in FROZEN.items() if two_registers(method)]


ROOT = Path(__file__).parents[2]


class TestConversion:
    def test_exact_coefficients(self):
        method = from_two_registers(*WILLIAMSON, name="W", source="Williamson")
        assert (method.name, method.source) == ("W", "Williamson")
        assert method.order == 3
        assert method.points[2] == Point(
            1, {0: Fraction(17, 48), 1: Fraction(-51, 80), 2: Fraction(8, 15)}
        )
        assert method.stage_points == (-1, 0, 1)
        actual = two_registers(method)
        assert actual == tuple(tuple(map(Fraction, row)) for row in WILLIAMSON)
        assert all(coefficient.unit == 0 for coefficient in method.coefficients)

    def test_rounded_coefficients(self):
        a, b = two_registers(methods["CF4b"])
        printed = Fraction(-567301805773, 1357537059087), Fraction(2277821191437, 14882151754819)
        assert abs(a[1] - printed[0]) < 1e-24
        assert abs(b[4] - printed[1]) < 1e-24
        again = from_two_registers(*[[to_decimal(x, 36) for x in row] for row in (a, b)])
        assert again.order == 4
        assert two_registers(again) is not None

    def test_other_methods_have_no_registers(self):
        assert {"CF3b", "CF4b", "LieEuler"} <= set(NAMES)
        assert not {"CF3", "CF4", "CG3", "CG4(3)", "ImplicitMidpoint", "CG2"} & set(NAMES)

    @pytest.mark.parametrize(("a", "b", "words"), [
        ([0, 1], [1], "b must have 2 entries"),
        ([], [], "a must have at least one entry"),
        (["1/2"], [1], r"a\[0\] must be 0.*1/2"),
        ([0, 1], [1, 0], r"b\[1\] must not be 0"),
        ([0, "x"], [1, 1], r"a\[1\]"),
        ([0, 1], [1, float("nan")], r"b\[1\]"),
        ("01", [1, 1], "a must be a sequence"),
        ([0], 1, "b must be a sequence"),
    ])  # fmt: skip
    def test_bad_input(self, a, b, words):
        refuses(MethodError, words, from_two_registers, a, b)


class TestOrderOnManifolds:
    """Methods of two registers that have an order in flat space have it on manifolds."""

    def test_published_methods(self, tool):
        rows = [tool.row_of(entry) for entry in tool.entries()]
        assert len(rows) == 17
        for row in rows:
            assert row.order == row.flat_order, row.name
            assert row.flat < 1e-6, row.name
            assert row.on_manifolds < 1e-6, row.name
            assert row.beyond > 1e-3, row.name
            assert row.moved < 1e-6, row.name
            assert row.flat_refined < 1e-60, row.name
            assert row.refined < 1e-55, row.name
        page = (ROOT / "docs/mathematics/two_registers.md").read_text(encoding="utf-8")
        assert tool.table_of(rows) in page, "out of date; run research/low_storage.py"


class TestSteps:
    """The compiled step in two registers against the one with all stages."""

    def test_paths_have_the_registers(self):
        assert paths_of(methods["CF4b"]).registers == two_registers(methods["CF4b"])
        assert methods["CF4b"].table().record.registers
        assert not methods["CF4"].table().record.registers

    @pytest.mark.parametrize("problem", list(PROBLEMS))
    @pytest.mark.parametrize("name", NAMES)
    def test_equal_to_rounding(self, problem, name, affine_rhs):
        problem = PROBLEMS[problem]
        f, _keep = affine_rhs(problem)
        options = {"frame": problem.frame, "method": name, "h": 0.07}
        fast = integrate(f, (0.2, 1.0), problem.y0, **options)
        options["method"] = without_registers(methods[name])
        slow = integrate(f, (0.2, 1.0), problem.y0, **options)
        np.testing.assert_allclose(fast.y, slow.y, rtol=0, atol=2e-14)
        assert (fast.nfev, fast.nexp) == (slow.nfev, slow.nexp)
