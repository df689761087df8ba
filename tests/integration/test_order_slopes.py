"""Orders of all explicit methods, on problems that depend on every coefficient."""

import numpy as np
import pytest
from kinds import FROZEN

from cg.analysis.convergence import observed_order, slopes
from cg.frames import SE3, SO3, Sphere, UnitQuaternion
from cg.problems.affine import AffineField
from cg.reproduce.reference_runs import integrate_compiled

EXPLICIT = {name: tableau for name, tableau in FROZEN.items() if tableau.explicit}
EXACT = {name: tableau for name, tableau in EXPLICIT.items() if not tableau.approximate}
WEIGHTS = {
    **{name: (tableau, tableau.order) for name, tableau in EXACT.items()},
    **{
        f"{name}, embedded": (tableau.embedded, tableau.embedded_order)
        for name, tableau in EXACT.items()
        if tableau.embedded is not None
    },
}
AFFINE = {
    "SO3 body": (SO3(), np.eye(3)),
    "SO3 space": (SO3("space"), np.eye(3)),
    "SE3": (SE3(), np.eye(4)),
    "quaternion": (UnitQuaternion(), np.array([0.0, 0.0, 0.0, 1.0])),
    "sphere": (Sphere(2), np.array([0.0, 0.0, 1.0])),
}


@pytest.fixture(scope="module", params=list(AFFINE))
def affine(request):
    frame, initial = AFFINE[request.param]
    problem = AffineField(frame, initial, seed=1)
    return problem, problem.reference([1], bits=192).values[0][:-1]


@pytest.mark.parametrize("name", list(WEIGHTS))
def test_slope_is_the_order_in_quadruple_precision(affine, name):
    (problem, exact), (tableau, order) = affine, WEIGHTS[name]
    steps = 2 ** np.arange(5, 8) if order > 2 else 2 ** np.arange(7, 10)
    errors = []
    for n in map(int, steps):
        end = integrate_compiled(problem, method=tableau, h=f"1/{n}", steps=n, kind="real128")
        errors.append(float(max(abs(x - y) for x, y in zip(end.exact(-1), exact, strict=True))))
    slope = observed_order(1 / steps, errors, floor=1e-31)
    assert slope.order == pytest.approx(order, abs=0.1)
    assert slope.spread < 0.2


def test_slope_of_exact_powers():
    h = np.array([0.05, 0.4, 0.1, 0.2])
    slope = observed_order(h, 3.0 * h**4)
    assert slope.order == pytest.approx(4.0)
    assert slope.constant == pytest.approx(3.0)
    assert slope.spread == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_array_equal(slope.h, [0.4, 0.2, 0.1, 0.05])
    np.testing.assert_allclose(slopes(h, h**2.5), 2.5)


def test_asymptotic_range_leaves_out_coarse_steps_and_rounding():
    h = np.array([1.0, 0.5, 0.25, 0.125, 0.0625])
    errors = np.array([3.0, 0.25, 0.0625, 0.015625, 1e-16])
    assert observed_order(h, errors, floor=1e-15, h_range=(0.0, 0.5)).order == pytest.approx(2.0)
    assert observed_order(h, errors, h_range=(0.1, 0.5)).order == pytest.approx(2.0)
    assert observed_order(h[:4], errors[:4]).order > 2.2


@pytest.mark.parametrize(
    ("h", "errors", "changes", "message"),
    [
        ([0.1, 0.2], [1.0], {}, "must be vectors of one length"),
        ([[0.1, 0.2]], [[1.0, 2.0]], {}, "must be vectors of one length"),
        ([0.1, 0.2], [1.0, np.nan], {}, "errors must be positive and finite"),
        ([0.1, 0.2], [1.0, np.inf], {}, "errors must be positive and finite"),
        ([0.1, -0.2], [1.0, 2.0], {"h_range": (-1.0, 1.0)}, "h must be positive and finite"),
        ([0.1, 0.1], [1.0, 2.0], {}, "h must be distinct"),
        ([0.1, 0.2], [1e-17, 1.0], {"floor": 1e-15}, "errors must leave two points"),
        ([0.1, 0.2], [1.0, 2.0], {"h_range": (0.15, 1.0)}, "errors must leave two points"),
    ],
)
def test_bad_errors_are_refused(h, errors, changes, message):
    with pytest.raises(ValueError, match=message):
        observed_order(h, errors, **changes)
