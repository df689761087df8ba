"""Affine fields: orders on frames whose flows don't commute."""

import numpy as np
import pytest

from cg.analysis.convergence import observed_order
from cg.catalogue import methods
from cg.frames import SE3, SU, Product, Sphere, UnitQuaternion
from cg.integration import integrate
from cg.problems import AffineField

UNIT = [0.0, 0.0, 0.0, 1.0]


ORDER_FRAMES = {
    "SE3": (SE3(), np.eye(4)),
    "SU2": (Product(SU(2)), np.array([1, 0, 0, 0, 0, 0, 1, 0])),
    "S2": (Sphere(2), [0.0, 0.0, 1.0]),
    "quaternion": (UnitQuaternion(), UNIT),
}


@pytest.fixture(scope="module", params=list(ORDER_FRAMES))
def affine(request):
    problem = AffineField(*ORDER_FRAMES[request.param], seed=3)
    exact = problem.reference([1], bits=96).y[0, :-1].reshape(problem.frame.point_shape)
    return problem, exact


def end_error(problem, exact, tableau, n):
    options = {"frame": problem.frame, "method": tableau, "h": 1 / n}
    return np.abs(integrate(problem.f, (0, 1), problem.y0, **options).y[-1] - exact).max()


@pytest.mark.parametrize(
    ("name", "steps"), [("CG3", (32, 64, 128)), ("CG4a", (16, 32, 64)), ("CG5a", (8, 16, 32))]
)
def test_order_slopes(affine, name, steps):
    errors = [end_error(*affine, name, n) for n in steps]
    order = observed_order(1.0 / np.array(steps), errors).order
    assert order == pytest.approx(methods[name].order, abs=0.15)


def test_affine_fields_see_the_rows(affine):
    """With two columns of a row exchanged the order drops, abscissae being the same."""
    from cg.method.tableau import Tableau

    tableau = methods["CG4a"]
    a = tableau.a.copy()
    a[3, :2] = a[3, 1::-1]
    wrong = Tableau(a.tolist(), tableau.b.tolist())
    np.testing.assert_allclose(wrong.c, tableau.c, atol=1e-15)
    errors = [end_error(*affine, wrong, n) for n in (32, 64, 128)]
    assert observed_order([1 / 32, 1 / 64, 1 / 128], errors).order < 3.3


def test_affine_field_on_a_batch():
    problem = AffineField(SE3(), np.eye(4))
    points = problem.frame.random_point(np.random.default_rng(1), (2, 3))
    found = problem.f(0.5, points)
    assert found.shape == (2, 3, 6)
    np.testing.assert_allclose(found[1, 2], problem.f(0.5, points[1, 2]), rtol=0, atol=1e-15)
