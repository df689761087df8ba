"""Orders of a few methods on all frames."""

from functools import cache

import numpy as np
import pytest
from ambient import solve_in_ambient_space
from frame_examples import HEISENBERG, generic
from kinds import FROZEN, MUNTHE_KAAS
from other_paths import reversed_flows
from slow_cases import slow

from cg import frames as fr
from cg.construction.methods.tableau import Tableau
from cg.integration import integrate

pytestmark = pytest.mark.no_core

EXACT = {name: method for name, method in FROZEN.items() if not method.approximate}
ALL = EXACT | MUNTHE_KAAS
WEIGHTS = {name: (method, method.order) for name, method in ALL.items()} | {
    f"{name}, embedded": (method.embedded, method.embedded_order)
    for name, method in ALL.items()
    if method.embedded is not None
}


def move(v, y):
    """Return the flow of translations along an axis, dilations and rotations of the plane."""
    rate, z = v[1] + 1j * v[2], y[0] + 1j * y[1]
    moved = np.exp(rate) * z + v[0] * (np.expm1(rate) / rate if rate else 1.0)
    return np.array([moved.real, moved.imag])


SIMILARITIES = [lambda y: np.array([1.0, 0.0]), lambda y: y, lambda y: np.array([-y[1], y[0]])]
FRAMES = {
    "SU2": fr.SU(2),
    "matrices": fr.MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[0.5, 0.0], [1.0, -0.5]]]),
    "functions": fr.FieldFrame(SIMILARITIES, move, point_shape=2),
    "functions without brackets": HEISENBERG, "SO3": fr.SO3(), "SE3": fr.SE3(),
    "SE3 space": fr.SE3("space"), "quaternion": fr.UnitQuaternion(), "S2": fr.Sphere(2),
    "GL2": fr.GL(2), "isospectral": fr.IsospectralOrbit((0.0, 1.0, 2.5)),
    "coadjoint": fr.CoadjointOrbit(fr.SO3(), (0.6, 0.0, 0.8)),
    "product": fr.Product(fr.SU(2), fr.Sphere(2)),
}  # fmt: skip
KINDS = {"CG3", "CG4a", "CG2(3), embedded", "CF5(4)", "DICG4"}


@cache
def problem_on(name):
    """Return a frame, an equation on it, and its solution at 1 computed in the space around."""
    frame = FRAMES[name]
    f, y0 = generic(frame, seed=5)

    return frame, f, y0, solve_in_ambient_space(frame, f, y0, [1.0])[0]


def slope_of(name, method, max_steps=64):
    """Return the slope at the smallest errors that are above rounding."""
    frame, f, y0, exact = problem_on(name)
    errors = []
    for n in 3 * 2 ** np.arange(int(np.log2(max_steps))):
        end = integrate(f, (0, 1), y0, frame=frame, method=method, h=1 / n).y[-1]
        errors.append(np.abs(end - exact).max())
        if errors[-1] < 1e-11 and len(errors) > 1:
            break
    return np.log2(errors[-2] / errors[-1])


@pytest.mark.parametrize(
    ("frame", "name"),
    [(frame, name) for frame in FRAMES for name in WEIGHTS if frame == "SU2" or name in KINDS],
)
def test_slope_is_the_order(frame, name):
    method, order = WEIGHTS[name]
    # the error constant of CF4r is so small that its errors of order five are larger at these steps
    assert slope_of(frame, method) == pytest.approx(order + (name == "CF4r"), abs=0.5)


@pytest.mark.parametrize("name", ["CG4a", "DICG4"])
@pytest.mark.parametrize("frame", FRAMES)
def test_flows_in_reverse_order_lower_the_order(frame, name):
    assert slope_of(frame, reversed_flows(EXACT[name])) < 2.6


@pytest.mark.parametrize(
    ("frame", "name"), [("SU2", "CG4a"), ("SU2", "DICG4"), *slow(("SU2", "CG6d"), ("SU2", "DICG6"))]
)
def test_each_coefficient_counts(frame, name):
    method = EXACT[name]
    for i, j in zip(*np.nonzero(method.a), strict=True):
        a = method.a.copy()
        a[i, j] += 0.01
        wrong = Tableau(a.tolist(), method.b.tolist())
        assert slope_of(frame, wrong) < method.order - 0.5, (i, j)
