"""Orders of methods on many frames, with right sides that depend on time and on every entry."""

import numpy as np
import pytest
from frame_examples import HEISENBERG

from cg.analysis.convergence import final_errors, observed_order
from cg.frames import (
    GL,
    SE3,
    SO3,
    SU,
    CoadjointOrbit,
    IsospectralOrbit,
    MatrixFrame,
    Product,
    Sphere,
    UnitQuaternion,
)
from cg.integration import integrate

FRAMES = {
    "SE3": SE3(),
    "SE3 space": SE3("space"),
    "quaternion": UnitQuaternion(),
    "SU2": SU(2),
    "GL2": GL(2),
    "S2": Sphere(2),
    "isospectral": IsospectralOrbit((0.0, 1.0, 2.5)),
    "momentum": CoadjointOrbit(SO3(), (0.6, 0.0, 0.8)),
    "matrices": MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[0.5, 0.0], [1.0, -0.5]]]),
    "functions": HEISENBERG,
    "product": Product(SU(2), Sphere(2)),
}
STEPS = (32, 48, 64, 96)


def state_dependent(frame, rng):
    """Return f(t, y), affine in time and in the entries of y, without any symmetry."""
    entries = int(np.prod(frame.point_shape)) * (2 if frame.dtype.kind == "c" else 1)
    constant, slope = rng.standard_normal((2, frame.dim))
    linear = rng.standard_normal((frame.dim, entries)) / np.sqrt(entries)

    def f(t, y):
        return 0.5 * (constant + t * slope) + linear @ np.ravel(y).view(np.float64)

    return f


@pytest.fixture(scope="module", params=list(FRAMES))
def problem(request):
    frame = FRAMES[request.param]
    rng = np.random.default_rng(50)
    f, y0 = state_dependent(frame, rng), frame.random_point(rng)
    exact = integrate(f, (0, 1), y0, frame=frame, method="CG5a", h=1 / 256).y[-1]
    return frame, f, y0, exact


@pytest.mark.parametrize(("method", "order"), [("CG3", 3), ("CG4a", 4)])
def test_slope_is_the_order(problem, method, order):
    frame, f, y0, exact = problem
    h = 1.0 / np.array(STEPS)
    errors = final_errors(f, (0.0, 1.0), y0, exact, frame=frame, method=method, h=h)
    slope = observed_order(h, errors, floor=1e-12)
    assert len(slope.h) == len(STEPS)
    assert slope.order == pytest.approx(order, abs=0.1)
