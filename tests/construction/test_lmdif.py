"""lmdif against SciPy's and Debian's MINPACK on the problems of Moré, Garbow and Hillstrom."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from minpack_libraries import DebianMinpack, load_debian_minpack
from more_garbow_hillstrom import PROBLEMS
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import leastsq

import cg

EPS = float(np.finfo(float).eps)
BY_NAME = {problem.name: problem for problem in PROBLEMS}
CASES = [(problem.name, factor) for problem in PROBLEMS for factor in (1, 10, 100)]
SOME = ("rosenbrock", "bard", "kowalik-osborne", "osborne-1", "brown-dennis", "chebyquad-8")

# On the way the residual overflows. leastsq goes on with infinities; lmdif stops and says so.
OVERFLOWS = {("box-three-dimensional", 10), ("jennrich-sampson", 100), ("osborne-1", 100)}


class Recorded:
    """A residual that records its arguments and values."""

    def __init__(self, problem):
        self._residual = problem.residual
        self.points = []
        self.values = []

    def __call__(self, x):
        with np.errstate(over="ignore", invalid="ignore"):
            value = self._residual(x)
        self.points.append(x.copy())
        self.values.append(value.copy())
        return value


def scipy_solve(problem, start, **options):
    """Return leastsq's result and its evaluations, without those before the solver starts."""
    residual = Recorded(problem)
    with np.errstate(all="ignore"):
        answer = leastsq(residual, start, full_output=True, **options)
    extra = len(residual.points) - answer[2]["nfev"]
    residual.points, residual.values = residual.points[extra:], residual.values[extra:]
    return residual, answer


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("options", [
    {},
    {"ftol": 0.0, "xtol": 0.0},
    {"ftol": 0.0, "xtol": 0.0, "gtol": 1e-3},
    {"ftol": 1e-3, "xtol": 1e-3},
    {"ftol": 1e-4, "xtol": 0.0},
    {"ftol": 0.0, "xtol": 1e-3},
    {"maxfev": 20},
    {"factor": 0.1},
    {"epsfcn": 1e-10},
    {"diag": True},
], ids=str)  # fmt: skip
def test_iterates_equal_scipy_with_options(name, options):
    problem = BY_NAME[name]
    if "diag" in options:
        options = {"diag": 0.5 + np.arange(problem.n)}
    defaults = {"ftol": EPS**0.5, "xtol": EPS**0.5, "epsfcn": EPS}
    _, (x, _, details, _, info) = scipy_solve(problem, problem.start(1), **{**defaults, **options})
    fit = cg.lmdif(problem.residual, problem.start(1), **options)
    assert (fit.info, fit.nfev) == (info, details["nfev"])
    assert fit.success is (info < 5)
    assert_allclose(fit.x, x, rtol=1e-12)


@pytest.mark.skipif(load_debian_minpack() is None, reason="libminpack (minpack-dev) not found")
@pytest.mark.parametrize(("name", "factor"), CASES)
def test_iterates_equal_minpack_bitwise(name, factor):
    # epsfcn as Debian's idea of the machine precision, or its differences have other steps.
    problem = BY_NAME[name]
    library = load_debian_minpack()
    assert library is not None
    run = Recorded(problem)
    theirs = DebianMinpack(library).lmdif(
        run, problem.start(factor), problem.m, ftol=EPS**0.5, xtol=EPS**0.5, gtol=0.0,
        maxfev=200 * (problem.n + 1), epsfcn=DebianMinpack.EPS, factor=100.0,
    )  # fmt: skip
    if (name, factor) in OVERFLOWS:
        # MINPACK goes on with infinities: its path is ours up to the first of them
        ours = Recorded(problem)
        with pytest.raises(ValueError, match="f must"):
            cg.lmdif(ours, problem.start(factor), epsfcn=DebianMinpack.EPS)
        first = next(k for k, value in enumerate(run.values) if not np.isfinite(value).all())
        assert first > problem.n
        assert_array_equal(ours.points, run.points[: first + 1])
        assert_array_equal(ours.values, run.values[: first + 1])
        return
    fit = cg.lmdif(problem.residual, problem.start(factor), epsfcn=DebianMinpack.EPS)
    assert {key: getattr(fit, key) for key in ("info", "nfev")} == {
        key: theirs[key] for key in ("info", "nfev")
    }
    for key in ("x", "fvec", "fjac", "ipvt", "qtf"):
        assert_array_equal(getattr(fit, key), theirs[key], err_msg=key)


@pytest.mark.parametrize("name", BY_NAME)
def test_reaches_published_minimum(name):
    # From one start at least: from others MINPACK stops elsewhere, or at maxfev.
    problem = BY_NAME[name]
    reached = [
        cg.lmdif(problem.residual, problem.start(factor)).residual_norm ** 2
        for factor in (1, 10, 100)[: problem.tries]
    ]
    assert any(
        math.isclose(value, minimum, rel_tol=1e-4, abs_tol=1e-20)
        for value in reached
        for minimum in problem.minima
    ), reached


def linear_systems():
    def draw(size):
        n, extra, seed = size
        rng = np.random.default_rng(seed)
        q, _ = np.linalg.qr(rng.normal(size=(n + extra, n)))
        a = q * rng.uniform(0.5, 2, n) @ np.linalg.qr(rng.normal(size=(n, n)))[0]
        return a, rng.normal(size=n + extra), rng.normal(size=n)

    return st.tuples(st.integers(1, 8), st.integers(0, 6), st.integers(0, 2**32 - 1)).map(draw)


@given(linear_systems())
def test_linear_problem_takes_few_evaluations(system):
    a, b, x0 = system
    fit = cg.lmdif(lambda x: a @ x - b, x0)
    assert fit.success
    assert fit.nfev <= 1 + 4 * (x0.size + 1)
    # Differences over steps of 1.5e-8 |x_j|, of numbers near 1: right to eps / 1.5e-8 |x_j|.
    assert_allclose(fit.x, np.linalg.lstsq(a, b)[0], atol=1e-5)


@settings(max_examples=60)
@given(st.sampled_from(SOME), st.integers(-20, 20), st.sampled_from(["residuals", "x", "diag"]))
def test_scaling_by_powers_of_two(name, power, what):
    problem, unit = BY_NAME[name], 2.0**power
    residual, start, diag = problem.residual, problem.start(1), 0.5 + np.arange(problem.n)
    if what == "residuals":
        unscaled = cg.lmdif(residual, start)
        scaled = cg.lmdif(lambda x: residual(x) * unit, start)
    elif what == "x":
        unscaled = cg.lmdif(residual, start)
        scaled = cg.lmdif(lambda x: residual(x * unit), start / unit)
    else:
        unscaled = cg.lmdif(residual, start, diag=diag)
        scaled = cg.lmdif(residual, start, diag=diag * unit)
    assert (scaled.info, scaled.nfev) == (unscaled.info, unscaled.nfev)
    assert_array_equal(scaled.x * (unit if what == "x" else 1.0), unscaled.x)


@pytest.mark.parametrize("power", [-520, -70, 70, 520])
def test_norms_of_tiny_and_of_huge_residuals(power):
    problem, unit = BY_NAME["rosenbrock"], 2.0**power
    fit = cg.lmdif(lambda x: problem.residual(x) * unit, problem.start(1))
    assert fit.success
    assert_allclose(fit.x, 1.0, rtol=1e-12)
    bard, start = BY_NAME["bard"], BY_NAME["bard"].start(1)
    norm = cg.lmdif(lambda x: bard.residual(x) * unit, start).residual_norm
    assert_allclose(norm / unit, cg.lmdif(bard.residual, start).residual_norm, rtol=1e-10)
