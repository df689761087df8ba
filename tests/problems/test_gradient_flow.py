"""The gradient flow of lattice gauge theory."""

from fractions import Fraction

import numpy as np
import pytest

from cg.frames import SU
from cg.integration import integrate
from cg.problems import GradientFlow

LATTICE = GradientFlow((2, 2))


def test_gradient_flow_follows_the_gradient():
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


def test_gradient_flow_is_gauge_invariant():
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
def test_gradient_flow_reference_to_thirty_digits():
    problem = GradientFlow()
    found = problem.reference([Fraction(1, 8)])
    assert max(found.errors) < 1e-30
    y = found.y.view(complex).reshape(problem.y0.shape)
    end = integrate(
        problem.f, (0, 0.125), problem.y0, frame=problem.frame, method="CF6c", h=1 / 512
    ).y[-1]
    np.testing.assert_allclose(end, y, rtol=0, atol=2e-14)
