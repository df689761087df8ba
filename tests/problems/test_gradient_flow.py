"""The gradient flow of lattice gauge theory."""

from fractions import Fraction

import numpy as np
import pytest

from cg.frames import SU
from cg.integration import integrate
from cg.problems import GradientFlow

LATTICE = GradientFlow((2, 2))


def test_the_gradient_flow_descends_along_the_gradient():
    problem = GradientFlow((3, 2, 2))
    y, h = problem.y0, 1e-5
    slope = problem.f(0.0, y)
    up, down = (problem.action(problem.frame.flow(s * h * slope, y)) for s in (1, -1))
    # The basis has squares of length one half.
    assert (up - down) / (2 * h) == pytest.approx(-0.5 * slope @ slope, rel=1e-8)
    for k in range(0, len(slope), 31):
        v = np.zeros(len(slope))
        v[k] = h
        up, down = (problem.action(problem.frame.flow(s * v, y)) for s in (1, -1))
        assert (up - down) / (2 * h) == pytest.approx(-0.5 * slope[k], abs=1e-6)


def test_the_gradient_flow_does_not_see_the_gauge():
    rng = np.random.default_rng(3)
    gauge = SU(3).random_point(rng, 4)
    y, h = LATTICE.y0, 1 / 32
    turned = LATTICE.rotated(y, gauge)
    assert LATTICE.action(turned) == pytest.approx(LATTICE.action(y), rel=1e-14)
    ends = [
        integrate(LATTICE.f, (0, 1), start, frame=LATTICE.frame, method="CF4", h=h).y[-1]
        for start in (y, turned)
    ]
    np.testing.assert_allclose(LATTICE.rotated(ends[0], gauge), ends[1], rtol=0, atol=1e-13)
    actions = LATTICE.action(
        integrate(LATTICE.f, (0, 1), y, frame=LATTICE.frame, method="CF4", h=h).y
    )
    assert (np.diff(actions) < 0.0).all()


@pytest.mark.slow
def test_thirty_digits_of_the_gradient_flow():
    problem = GradientFlow()
    found = problem.reference([Fraction(1, 8)])
    assert max(found.errors) < 1e-30
    y = found.y.view(complex).reshape(problem.y0.shape)
    end = integrate(
        problem.f, (0, 0.125), problem.y0, frame=problem.frame, method="CF6c", h=1 / 512
    ).y[-1]
    np.testing.assert_allclose(end, y, rtol=0, atol=2e-14)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sides": (2,)}, "sides must be two or more positive integers"),
        ({"sides": 3}, "sides must be two or more positive integers"),
        ({"sides": (2, 0)}, r"sides\[1\] must be at least 1"),
        ({"roughness": np.nan}, "roughness must be a finite number"),
        ({"seed": -1}, "seed must be at least 0"),
    ],
)
def test_bad_lattices(arguments, message):
    with pytest.raises(ValueError, match=message):
        GradientFlow(**arguments)
    with pytest.raises(ValueError, match="y must have shape"):
        LATTICE.action(np.eye(3))
