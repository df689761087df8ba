"""A build without quadruple precision: doubles work, quadruple precision raises an error."""

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.construction.conditions import residuals
from cg.construction.solvers.refine import refine
from cg.construction.solvers.system import ConditionSystem
from cg.support import quads
from cg.support.quads import MissingQuadsError

pytestmark = pytest.mark.no_core


@pytest.fixture(autouse=True)
def hide_quads(monkeypatch):
    monkeypatch.setattr(quads, "_compiled", lambda: None)


@pytest.mark.parametrize(("call", "name"), [
    (lambda: cg.search(order=2, stages=2, starts=1, seed=1), r"cg\.search"),
    (lambda: cg.construct(order=3, stages=3, seed=1), r"cg\.construct"),
    (lambda: quads.from_float([1.0]), r"cg\.support\.quads\.from_float"),
    (lambda: quads.to_float(quads.encode([1])), r"cg\.support\.quads\.to_float"),
    (lambda: refine(quads.encode([0, 1, 1]), ConditionSystem.tableau(2, 2)), "refinement"),
])  # fmt: skip
def test_missing_quads_error_names_the_function(call, name):
    refuses(MissingQuadsError, rf"^{name} needs quadruple precision.*-Dquad", call)


def test_doubles_work_without_quads():
    top = cg.problems.HeavyTop()
    run = cg.integrate(top.f, (0, 0.2), top.y0, frame=top.frame, method="CG4a", h=0.01)
    assert np.isfinite(run.y).all()
    assert np.abs(residuals(cg.methods["CG6f"], 6)).max() < 1e-13
    assert cg.certify(cg.methods["CG4b"]).order == 4
    assert cg.lift(cg.Tableau([[], ["1/2"], [-1, 2]], ["1/6", "2/3", "1/6"])).method.order == 3
    fit = cg.lmdif(lambda x: np.array([x[0] - 1, 10 * (x[1] - x[0] ** 2)]), [2.0, 2.0])
    np.testing.assert_allclose(fit.x, 1.0, atol=1e-10)
    assert quads.decode(quads.encode(["1/3"]))[0].denominator == 2**114
