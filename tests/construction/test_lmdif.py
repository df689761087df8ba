"""lmdif against SciPy's and Debian's MINPACK on the problems of Moré, Garbow and Hillstrom."""

import numpy as np
import pytest
from minpack_libraries import DebianMinpack, load_debian_minpack
from more_garbow_hillstrom import PROBLEMS
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import leastsq

import cg
from cg import conditions
from cg.construction.layouts.layout import Layout
from cg.construction.search import start as random_start
from cg.construction.search.shapes import start_generator
from cg.support import quads

EPS = float(np.finfo(float).eps)
BY_NAME = {problem.name: problem for problem in PROBLEMS}
CASES = [(problem.name, factor) for problem in PROBLEMS for factor in (1, 10, 100)]
SOME = ("rosenbrock", "bard", "kowalik-osborne", "osborne-1", "brown-dennis", "chebyquad-8")

# On the way the residual overflows. leastsq goes on with infinities; lmdif stops and says so.
OVERFLOWS = {("osborne-1", 100)}


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


def test_pivots_by_norms_that_cancel_are_scipys():
    """Of columns that differ by 1e-9 from the first, of which the second differs by more."""
    matrix = np.array([[2.0, 1.0, 1.0], [0.0, 3e-9, 0.0], [0.0, 0.0, 2e-9], [0.0, 0.0, 0.0]])
    f = lambda x: matrix @ x - [1.0, 0.0, 0.0, 4.0]
    details = leastsq(f, np.zeros(3), full_output=True, maxfev=8)[2]
    assert cg.lmdif(f, np.zeros(3), maxfev=8).ipvt.tolist() == details["ipvt"].tolist() == [0, 1, 2]


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
        with pytest.raises(ValueError, match="the residuals must be finite"):
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


def test_tolerances_of_the_papers_search(monkeypatch):
    given = []
    fit_lmdif = random_start.fit_lmdif

    def recorded(order, layout, x, trees, tolerance, *rest):
        given.append(tolerance)
        return fit_lmdif(order, layout, x, trees, tolerance, *rest)

    monkeypatch.setattr(random_start, "fit_lmdif", recorded)
    result = cg.search(3, 3, 3, seed=0, algorithm="lmdif", workers=1, refine_below=1.0)
    assert any(start.quad is not None for start in result.starts)
    doubles = [tolerance for tolerance in given if tolerance.dtype == np.float64]
    others = [tolerance for tolerance in given if tolerance.dtype != np.float64]
    assert len(doubles) == 3
    assert others
    assert {float(tolerance[0]) for tolerance in doubles} == {1e-18}
    assert {quads.to_float(tolerance.T)[0] for tolerance in others} == {1e-32}


def test_search_status_is_that_of_solver():
    settings = cg.search(3, 3, 6, seed=0, algorithm="lmdif").settings
    layout = Layout.tableau(3)
    trees = [t for t in conditions.table_rows(3) if t]
    position = {t: k for k, t in enumerate(conditions.condition_trees(3))}

    def residual(x):
        rows = np.zeros(max(len(conditions.table_rows(3)), layout.size))
        residuals = conditions.residuals(layout, x, 3)
        for k, t in enumerate(conditions.table_rows(3)):
            rows[k] = residuals[position[t]] if t in trees else 0
        return rows

    for index in range(6):
        guess = start_generator(0, index).uniform(-settings.width, settings.width, layout.size)
        fit = cg.lmdif(residual, guess, ftol=1e-18, xtol=1e-18, maxfev=settings.maxfev)
        start = random_start.run_start(settings, index)
        assert (start.double.info, start.double.nfev) == (fit.info, fit.nfev)
        assert_array_equal(start.double.f, fit.fvec @ fit.fvec)
