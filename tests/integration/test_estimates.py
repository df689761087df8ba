"""Errors compared with error estimates: of coefficients, and on random families of problems."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from frame_examples import HEISENBERG
from slow_cases import slow

import cg
from benchmarks import estimates, page
from cg.construction.methods.estimate import MAX_RATIO, estimate_ratio
from cg.frames import SE3, SO3, SU, Euclidean, LinearAction, Sphere, Stiefel, UnitQuaternion
from cg.integration.default_method import choose_method

ROOT = Path(__file__).parents[2]
FRAMES = (SO3(), Stiefel(3, 2), HEISENBERG)
DEFAULTS = sorted({choose_method(frame, rtol) for frame in FRAMES for rtol in (None, 1e-3, 1e-8)})
PAIRS = [method for method in cg.methods.values() if method.embedded_order is not None]
LOW, HIGH = ([m for m in PAIRS if (m.order > 4) == high] for high in (False, True))
SPIN = LinearAction([
    -0.5j * m
    for m in (np.array([[0, 1], [1, 0]]), np.array([[0, -1j], [1j, 0]]), np.diag([1, -1]))
])  # fmt: skip


class TestRatios:
    @pytest.mark.parametrize("method", PAIRS, ids=lambda method: method.name)
    def test_all_pairs_of_the_catalogue(self, method):
        assert 0 < estimate_ratio(method) <= MAX_RATIO

    @pytest.mark.parametrize("name", DEFAULTS)
    def test_defaults_see_jumps(self, name):
        assert estimates.break_ratio(cg.construction.catalogue.resolve_method(name), 0) <= 50

    @pytest.mark.parametrize("name", ["DOP853", "RKMK8(5,3)"])
    def test_combined_estimates_see_kinks(self, name):
        """Estimates of one combination vanish at some times; so do squares, near these times."""
        assert estimates.break_ratio(cg.methods[name], 1) < 40
        assert estimates.break_ratio(cg.methods["DP5(4)"], 1) > 1000

    @pytest.mark.parametrize("method", ["Magnus8(4)", "CFM8(4)", "CFM6(4)", "CFM6(4)b"])
    @pytest.mark.parametrize("size", [1e-1, 1e-2, 1e-3, 1e-4])
    def test_changes_along_the_direction_of_f(self, method, size):
        """Quadratures differ by the change along f, commutators by the little across it."""

        def f(t):
            return [6 * (t - t**3), size * (1 - t), size * t * t]

        def result(**options):
            return cg.solve_linear(f, (0, 1.5), np.eye(3), frame=SO3("space"), **options).y[-1]

        reference = result(method="CFM8(4)", h=1 / 200)
        for tol in (1e-4, 1e-6, 1e-8):
            assert np.abs(result(method=method, rtol=tol, atol=tol) - reference).max() < 5 * tol

    def test_a_jump(self):
        """The trapezoidal rule and its first node: the estimate is half a step."""
        pair = cg.Tableau([[], [1]], ["1/2", "1/2"], b_embedded=[1, 0])
        assert estimates.break_ratio(pair, 0) == pytest.approx(1.0, rel=1e-2)
        assert estimate_ratio(cg.methods["CF4"]) is None

    @pytest.mark.parametrize("method", [*LOW, *slow(*HIGH)], ids=repr)
    def test_pairs_see_the_end_of_a_step(self, method):
        """Also those without a node there, of which `end_weights` takes account."""
        if method.explicit and not isinstance(method, cg.MagnusMethod):
            assert estimates.break_ratio(method, 0) < 200


@pytest.fixture(scope="module")
def families():
    """Return a function of the number of problems of each family, which computes them once."""
    return cache(lambda n: [(family, family.reference()) for family in estimates.families(n)])


class TestFamilies:
    """Random problems for each kind of equation and each frame, all hundred in the slow test."""

    def check(self, families, name, tolerances):
        quotients = np.array([
            family.errors(family.solve(name, tolerance), exact) / tolerance
            for family, exact in families
            for tolerance in tolerances
        ])  # fmt: skip
        assert np.median(quotients) <= 0.3
        assert quotients.max() <= estimates.MAX_QUOTIENT
        assert np.median(quotients) > 1e-4  # no needless accuracy

    @pytest.mark.parametrize("name", DEFAULTS)
    def test_defaults(self, families, name):
        self.check(families(20), name, (1e-3, 1e-7))

    @pytest.mark.slow
    @pytest.mark.parametrize("name", DEFAULTS)
    def test_all_tolerances(self, families, name):
        self.check(families(100), name, estimates.TOLERANCES)

    def test_the_default_of_linear_equations(self, families):
        """On the families of time alone."""
        quotients = []
        for family, exact in families(40):
            if family.name != "slow drift":
                continue
            for k in range(0, 40, 8):
                p = family.parameters[k : k + 1]
                for tolerance in (1e-3, 1e-6, 1e-10):
                    run = cg.solve_linear(
                        lambda t, f=family.f, p=p: f(np.array([t]), None, p)[0], (0, family.end),
                        family.points[k], frame=family.frame, rtol=tolerance, atol=tolerance,
                    )  # fmt: skip
                    errors = family.errors(run.y[-1:], exact[k : k + 1])
                    quotients.append(errors[0] / tolerance)
        assert len(quotients) == 105
        assert np.median(quotients) <= 0.1
        assert max(quotients) <= 5


def coefficients(random, dim):
    """Return random smooth coefficients that depend on time."""
    amplitude, frequency = random.normal(size=(dim, dim)), random.uniform(0.5, 5.0, dim)
    return lambda t: amplitude @ np.cos(frequency * t)


class TestDiscontinuities:
    """Jumps and kinks at unknown times within (0.2, 1.8), with tolerances of 1e-9."""

    @staticmethod
    def cases(dim, seed):
        random = np.random.default_rng(seed)
        for k in range(60):
            smooth, place = coefficients(random, dim), random.uniform(0.2, 1.8)
            change = random.normal(size=dim) * 10.0 ** random.uniform(-1, 1)
            size = (lambda t, p=place: t >= p) if k % 2 else (lambda t, p=place: abs(t - p))
            yield place, lambda t, s=smooth, c=change, size=size: s(t) + c * size(t)

    @pytest.mark.parametrize("frame", [SU(2), SPIN], ids=["SU(2)", "LinearAction"])
    def test_linear_equations(self, frame):
        y0 = np.eye(2) if frame is not SPIN else np.array([1.0, 0.0j])
        for place, a in self.cases(3, 1):
            run = cg.solve_linear(a, (0, 2), y0, frame=frame, rtol=1e-9, atol=1e-9)
            exact = cg.solve_linear(
                a, (0, 2), y0, frame=frame, method="CFM8(4)", h=0.01, breakpoints=[place]
            )
            assert np.abs(run.y[-1] - exact.y[-1]).max() < 5e-9

    @pytest.mark.parametrize("frame", [
        SO3(), UnitQuaternion(), SE3(), SU(3), Sphere(2), Euclidean(3), HEISENBERG
    ], ids=repr)  # fmt: skip
    def test_nonlinear_equations(self, frame):
        errors = self.errors(frame, "auto", 1e-9, 20 if frame is HEISENBERG else 60)
        assert np.median(errors) < 1
        assert errors.max() < 50

    BLIND_AT_THE_END = ("CF4(3)", "CG2(3)", "CG3(2)", "CG4(3)", "CG4(3)b", "CG5(4)", "CG6(5)")

    @pytest.mark.parametrize("name", BLIND_AT_THE_END)
    def test_pairs_without_a_node_at_the_end(self, name):
        """Both results of these pairs miss what happens after the last node of a step."""
        assert cg.methods[name].c.max() < 0.999
        assert self.errors(SO3(), name, 1e-6, 60).max() < 50

    @staticmethod
    @cache
    def problems(frame, count):
        """Return equations with their initial point and solutions."""
        start, problems = np.random.default_rng(3), []
        y0 = np.zeros(3) if frame is HEISENBERG else frame.random_point(start)
        for place, a in list(TestDiscontinuities.cases(frame.dim, 2))[:count]:
            f = lambda t, y, a=a: a(t) + 0.5 * np.tanh(np.resize(np.real(y), frame.dim))
            problem = f, (0, 2), y0
            options = {"rtol": 1e-12, "atol": 1e-12, "breakpoints": [place]}
            problems.append((problem, cg.solve_ivp(*problem, frame=frame, **options).y[-1]))
        return problems

    def errors(self, frame, method, tolerance, count):
        errors, options = [], {"method": method, "rtol": tolerance, "atol": tolerance}
        for problem, exact in self.problems(frame, count):
            run = cg.solve_ivp(*problem, frame=frame, **options)
            assert run.success
            errors.append(np.abs(run.y[-1] - exact).max() / (1 + np.abs(exact).max()) / tolerance)
        return np.array(errors)


@pytest.fixture(scope="module")
def page_results():
    return page.read(ROOT / "benchmarks" / "results.json")[0]["estimates"]


def test_defaults_follow_the_rule(page_results):
    kinds = ("compiled | time", "in Python, with brackets | flows")
    for frame, kind in zip(FRAMES, (*kinds, "without brackets | evaluations + flows"), strict=True):
        loose, tight = choose_method(frame, 1e-4), choose_method(frame, 1e-8)
        assert f"| {kind} | `{loose}` | `{tight}` |" in page_results.notes[0]


@pytest.mark.slow  # half a minute
def test_measured_estimates_in_the_catalogue(page_results, tmp_path):
    text = (ROOT / "docs" / "catalogue.md").read_text(encoding="utf-8")
    file = tmp_path / "page.md"
    file.write_text(f"{estimates.BEGIN}{estimates.END}", encoding="utf-8")
    estimates.write_table(page_results, file)
    table = file.read_text(encoding="utf-8")
    assert table in text
    assert {method.name for method in PAIRS}.issuperset(page_results.numbers)
    assert all(f"| `{method.name}` | " in table for method in PAIRS)
