"""Tolerances of lmdif: defaults and stopping criteria."""

import math

import numpy as np
import pytest
from more_garbow_hillstrom import PROBLEMS
from numpy.testing import assert_array_equal

import cg
from cg import conditions
from cg.construction.search import start as random_start
from cg.structure.layout import Layout
from cg.support import quads
from cg.support.shared_numbers import Status

pytestmark = pytest.mark.sanitize

EPS = float(np.finfo(float).eps)
BY_NAME = {problem.name: problem for problem in PROBLEMS}
CURVED = ("bard", "kowalik-osborne", "osborne-1")  # the residual isn't zero at their minima
CLOSE = 1e-6  # far above the rounding of a threshold, far below the distance to the next


class Path:
    """A residual that records its arguments."""

    def __init__(self, residual):
        self._residual = residual
        self.points = []

    def __call__(self, x):
        self.points.append(x.copy())
        return self._residual(x)


def solve(name, **options):
    """Return the fit and the last two accepted points."""
    problem = BY_NAME[name]
    path = Path(problem.residual)
    fit = cg.lmdif(path, problem.start(1), diag=np.ones(problem.n), **options)
    # differences are taken at accepted points: all but one element of n points are those of it
    n, actual = problem.n, []
    for k in range(len(path.points) - n + 1):
        block = np.array(path.points[k : k + n])
        base = np.array([block[(j + 1) % n, j] for j in range(n)]) if n > 1 else block[0]
        changed = block != base
        if np.array_equal(changed, np.eye(n, dtype=bool)):
            actual.append(base)
    return fit, actual[-1]


@pytest.mark.parametrize("n", [1, 2, 5])
def test_default_maxfev_is_that_of_minpack(n):
    # the tests of convergence never hold: |x| grows, and f falls to a half in each step
    fit = cg.lmdif(lambda x: np.exp2(-x), np.zeros(n), ftol=0, xtol=0, factor=1e-3, diag=np.ones(n))
    assert fit.info is Status.TOO_MANY_EVALUATIONS
    assert 200 * (n + 1) <= fit.nfev <= 200 * (n + 1) + n


@pytest.mark.parametrize("name", CURVED)
def test_ftol_bounds_actual_and_predicted_reduction(name):
    fit, before = solve(name, ftol=1e-4, xtol=0)
    assert fit.info is Status.SMALL_REDUCTION
    old, new = (np.linalg.norm(BY_NAME[name].residual(x)) for x in (before, fit.x))
    step = (fit.x - before)[fit.ipvt]
    predicted = (np.linalg.norm(np.triu(fit.fjac[: step.size]) @ step) / old) ** 2
    threshold = max(1 - (new / old) ** 2, predicted)
    assert 0 < threshold <= 1e-4
    for change, same in ((1 + CLOSE, True), (1 - CLOSE, False)):
        other, _ = solve(name, ftol=threshold * change, xtol=0)
        assert (other.nfev == fit.nfev) is same


@pytest.mark.parametrize("name", CURVED)
def test_xtol_bounds_next_step(name):
    fit, before = solve(name, ftol=0, xtol=1e-3)
    assert fit.info is Status.SMALL_STEP
    # after a step of Gauss and Newton the bound is twice its length
    threshold = 2 * np.linalg.norm(fit.x - before) / np.linalg.norm(fit.x)
    assert 0 < threshold <= 1e-3
    for change, same in ((1 + CLOSE, True), (1 - CLOSE, False)):
        other, _ = solve(name, ftol=0, xtol=threshold * change)
        assert (other.nfev == fit.nfev) is same


@pytest.mark.parametrize("name", CURVED)
def test_gtol_bounds_cosine(name):
    fit, _ = solve(name, ftol=0, xtol=0, gtol=1e-2)
    assert fit.info is Status.SMALL_GRADIENT
    r = np.triu(fit.fjac[: fit.x.size])
    cosines = np.abs(r.T @ fit.qtf) / np.linalg.norm(r, axis=0) / fit.residual_norm
    threshold = cosines.max()
    assert 0 < threshold <= 1e-2
    for change, same in ((1 + CLOSE, True), (1 - CLOSE, False)):
        other, _ = solve(name, ftol=0, xtol=0, gtol=threshold * change)
        assert (other.nfev == fit.nfev) is same


@pytest.mark.parametrize(("epsfcn", "size"), [(None, 2.0**-26), (0.0, 2.0**-26), (1e-10, 1e-5)])
def test_epsfcn_sets_steps_of_differences(epsfcn, size):
    path = Path(lambda x: x - 3)
    start = np.array([2.0, -0.5, 0.0])
    cg.lmdif(path, start, **({} if epsfcn is None else {"epsfcn": epsfcn}))
    expected = start + np.diag([2 * size, 0.5 * size, size])
    np.testing.assert_allclose(path.points[1:4], expected, rtol=4 * EPS, atol=0)


@pytest.mark.parametrize("factor", [1e-3, 0.1])
def test_factor_bounds_first_step(factor):
    path = Path(lambda x: x - 1000)
    start, diag = np.array([3.0, 4.0]), np.array([2.0, 0.5])
    cg.lmdif(path, start, factor=factor, diag=diag)
    bound = factor * math.hypot(*(diag * start))
    assert math.hypot(*(diag * (path.points[3] - start))) == pytest.approx(bound, rel=0.1)


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
        guess = random_start.random_start(0, index, layout.size, settings.width)
        fit = cg.lmdif(residual, guess, ftol=1e-18, xtol=1e-18, maxfev=settings.maxfev)
        start = random_start.run_start(settings, index)
        assert (start.double.info, start.double.nfev) == (fit.info, fit.nfev)
        assert_array_equal(start.double.f, fit.fvec @ fit.fvec)
