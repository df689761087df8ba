"""Tolerances of lmdif: defaults and stopping criteria."""

import numpy as np
from numpy.testing import assert_array_equal

import cg
from cg import conditions
from cg.construction.search import start as random_start
from cg.structure.layout import Layout
from cg.support import quads


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
