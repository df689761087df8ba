"""Methods of two registers: their form, their steps, and their order on manifolds."""

import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from compiled_examples import PROBLEMS
from kinds import FROZEN
from other_paths import without_registers
from refusals import refuses

from cg import MethodError, conditions
from cg.construction.catalogue import dumps, loads, methods
from cg.construction.layouts.points import Point
from cg.construction.methods.flat import flat_residuals
from cg.construction.methods.low_storage import from_two_registers, two_registers
from cg.construction.methods.paths import paths_of
from cg.integration import integrate, solve_ivp
from cg.support.quads import to_decimal

TOOL = "tools/write_low_storage_table"
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

    def test_detects_changed_last_places(self):
        text = dumps(methods["CF4b"])
        old = '"-0.469079580103165879125419671308191663"'
        assert old in text
        assert two_registers(loads(text.replace(old, old.replace("191663", "195663")))) is None
        assert two_registers(loads(text.replace(old, old.replace("191663", "191664")))) is not None

    def test_number_of_places_of_weights(self):
        a = ["0", "-0.4801594388478", "-1.4042471952", "-2.016477077503", "-1.056444269767"]
        b = [
            "0.1028639988105", "0.7408540575767", "0.7426530946684", "0.4694937902358",
            "0.1881733382888",
        ]  # fmt: skip
        method = from_two_registers(a, b)
        assert method.order == 4
        exact = from_two_registers(list(map(Fraction, a)), list(map(Fraction, b)))
        assert exact.order == 0
        for rounded, weight in zip(method.coefficients, exact.coefficients, strict=True):
            assert abs(rounded.value - weight.value) <= rounded.unit
            assert 0 < rounded.unit <= Fraction(1, 10**9)
        assert two_registers(method) is not None

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
        page = (ROOT / "docs" / "low_storage.md").read_text(encoding="utf-8")
        assert tool.table_of(rows) in page, "out of date; run tools/write_low_storage_table.py"

    def test_a_method_of_order_five(self, tool):
        a, b = two_registers(methods["CF5r"])
        parameters = [*a[1:], *b]
        actual = tool.closest(parameters, 5)
        assert max(abs(x - y) for x, y in zip(actual, parameters, strict=True)) < 1e-35
        refined = tool.weights_of(actual)
        assert max(map(abs, conditions.residuals(refined, 5, arithmetic="exact"))) < 1e-55
        assert max(map(abs, flat_residuals(*refined.exact, 6))) > 1e-5
        slopes = tool.slopes(parameters, 5)
        assert np.linalg.svd(slopes, compute_uv=False)[-1] > 1e-4


class TestSteps:
    """The compiled step in two registers against the one with all stages."""

    def test_paths_have_the_registers(self):
        assert paths_of(methods["CF4b"]).registers == two_registers(methods["CF4b"])
        assert methods["CF4b"].table().record.registers
        assert not methods["CF4"].table().record.registers

    @pytest.mark.parametrize("problem", list(PROBLEMS))
    @pytest.mark.parametrize("name", NAMES)
    def test_equal_to_rounding(self, problem, name, affine):
        problem = PROBLEMS[problem]
        f, _keep = affine(problem)
        options = {"frame": problem.frame, "method": name, "h": 0.07}
        fast = integrate(f, (0.2, 1.0), problem.y0, **options)
        options["method"] = without_registers(methods[name])
        slow = integrate(f, (0.2, 1.0), problem.y0, **options)
        np.testing.assert_allclose(fast.y, slow.y, rtol=0, atol=2e-14)
        assert (fast.nfev, fast.nexp) == (slow.nfev, slow.nexp)

    def test_slopes_at_starts_of_steps_are_kept(self, affine):
        problem = PROBLEMS["product"]
        f, _keep = affine(problem)
        at = np.linspace(0.2, 1.0, 23)
        options = {"frame": problem.frame, "method": "CF4b", "h": 0.1, "dense_output": True}
        fast = solve_ivp(f, (0.2, 1.0), problem.y0, **options)
        python = solve_ivp(problem.f, (0.2, 1.0), problem.y0, **options)
        options["method"] = without_registers(methods["CF4b"])
        slow = solve_ivp(f, (0.2, 1.0), problem.y0, **options)
        np.testing.assert_allclose(fast.sol(at), slow.sol(at), rtol=0, atol=2e-14)
        np.testing.assert_allclose(python.sol(at), slow.sol(at), rtol=0, atol=2e-14)
        assert fast.nfev == slow.nfev


class TestMemory:
    """A step stores the start, the current point, Z and f, for any number of stages."""

    SCRIPT = """
import re, sys
sys.path.append(sys.argv[2])
import numpy as np
import cg
from other_paths import as_they_are, without_registers
chosen = without_registers if sys.argv[1] == "general" else as_they_are
method = chosen(cg.methods["CF4b"])
n = 200_000
frame = cg.frames.Power(cg.frames.SO3(), n)
y = np.broadcast_to(np.eye(3), (n, 3, 3)).reshape(frame.point_shape)
f = np.ones(frame.dim)
cg.integrate(lambda t, y: f, (0.0, 1.0), y, frame=frame, method=method, h=0.5, save_every=2)
# unlike ru_maxrss, nothing of what the parent had
status = open("/proc/self/status").read()
print(int(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1]) * 1024 / (8 * n))
"""

    @pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux")
    def test_words_for_a_rotation(self):
        words = {}
        for path in ("general", "registers"):
            command = [sys.executable, "-c", self.SCRIPT, path, str(ROOT / "tests" / "helpers")]
            words[path] = float(subprocess.run(command, check=True, capture_output=True).stdout)
        # 7 points and 5 fields against 3 and 2: 78 words against 33; one of each is what f is given
        assert words["general"] - words["registers"] == pytest.approx(45, abs=5)
