"""Methods of two registers: their form, their steps, and their order on manifolds."""

import subprocess
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from compiled_examples import PROBLEMS

import cg
from cg import MethodError
from cg.catalogue import dumps, loads, methods
from cg.integration import built_in, compiled_stepper, integrate, solve_ivp
from cg.integration.built_in import integrate_affine
from cg.integration.paths import paths_of
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


class TestSteps:
    """The compiled step in two registers against the one with all stages."""

    @staticmethod
    def general(monkeypatch):
        for module in (compiled_stepper, built_in):
            monkeypatch.setattr(
                module, "paths_of", lambda method: replace(paths_of(method), registers=None)
            )

    def test_paths_have_the_registers(self):
        assert paths_of(methods["CF4b"]).registers == two_registers(methods["CF4b"])
        assert paths_of(methods["CF4b"]).integers[-1] == 1
        assert paths_of(methods["CF4"]).integers[-1] == 0

    @pytest.mark.parametrize("problem", list(PROBLEMS))
    @pytest.mark.parametrize("name", NAMES)
    def test_equal_to_rounding(self, problem, name, affine, monkeypatch):
        problem = PROBLEMS[problem]
        f, _keep = affine(problem)
        options = {"frame": problem.frame, "method": name, "h": 0.07}
        fast = integrate(f, (0.2, 1.0), problem.y0, **options)
        self.general(monkeypatch)
        slow = integrate(f, (0.2, 1.0), problem.y0, **options)
        np.testing.assert_allclose(fast.y, slow.y, rtol=0, atol=2e-14)
        assert (fast.nfev, fast.nexp) == (slow.nfev, slow.nexp)

    @pytest.mark.parametrize("kind", ["real64", "real128"])
    def test_equal_to_rounding_in_both_kinds(self, kind, monkeypatch):
        options = {"method": "CF4b", "h": "1/8", "steps": 8, "kind": kind}
        fast = integrate_affine(PROBLEMS["SO3 body"], **options)
        self.general(monkeypatch)
        slow = integrate_affine(PROBLEMS["SO3 body"], **options)
        off = [abs(x - y) for x, y in zip(fast.exact(-1), slow.exact(-1), strict=True)]
        assert max(off) < (1e-14 if kind == "real64" else 1e-32)
        if kind == "real128":
            assert max(off) > 0  # or the same steps were taken twice

    def test_slopes_at_the_beginnings_of_steps_stay(self, affine, monkeypatch):
        problem = PROBLEMS["product"]
        f, _keep = affine(problem)
        at = np.linspace(0.2, 1.0, 23)
        options = {"frame": problem.frame, "method": "CF4b", "h": 0.1, "dense_output": True}
        fast = solve_ivp(f, (0.2, 1.0), problem.y0, **options)
        python = solve_ivp(problem.f, (0.2, 1.0), problem.y0, **options)
        self.general(monkeypatch)
        slow = solve_ivp(f, (0.2, 1.0), problem.y0, **options)
        np.testing.assert_allclose(fast.sol(at), slow.sol(at), rtol=0, atol=2e-14)
        np.testing.assert_allclose(python.sol(at), slow.sol(at), rtol=0, atol=2e-14)
        assert fast.nfev == slow.nfev

    @pytest.mark.parametrize("stage", range(5))
    def test_a_failure_at_any_stage_leaves_the_step_undone(self, stage, monkeypatch):
        problem = PROBLEMS["SO3 body"]
        calls = 0

        def f(t, y):
            nonlocal calls
            calls += 1
            if calls == 11 + stage:
                raise ArithmeticError(t)
            return problem.f(t, y)

        times = []
        for _ in range(2):
            calls = 0
            with pytest.raises(ArithmeticError) as error:
                integrate(f, (0.0, 1.0), problem.y0, frame=problem.frame, method="CF4b", h=0.1)
            times.append(error.value.args[0])
            self.general(monkeypatch)
        assert times[0] == times[1]


class TestMemory:
    """A step keeps the start, the point that moves, Z and f, however many stages there are."""

    SCRIPT = """
import resource, sys
import numpy as np
import cg
from cg.integration import compiled_stepper, paths
from dataclasses import replace
if sys.argv[1] == "general":
    compiled_stepper.paths_of = lambda m: replace(paths.paths_of(m), registers=None)
n = 200_000
y = np.broadcast_to(np.eye(3), (n, 3, 3)).copy()
f = np.ones((n, 3))
cg.integrate(
    lambda t, y: f, (0.0, 1.0), y, frame=cg.frames.SO3(), method="CF4b", h=0.5, save_every=2
)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / (8 * n))
"""

    def test_words_a_rotation(self):
        words = {}
        for path in ("general", "registers"):
            command = [sys.executable, "-c", self.SCRIPT, path]
            words[path] = float(subprocess.run(command, check=True, capture_output=True).stdout)
        # 6 points and 5 fields against 2 and 2: 69 words against 24
        assert words["general"] - words["registers"] > 20
