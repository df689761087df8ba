"""The spinning top: its equations, its reference, and the compiled integrator in both kinds."""

from fractions import Fraction

import numpy as np
import pytest
from flint import arb

from cg.frames import SO3, Euclidean, Product, hat
from cg.problems import HeavyTop
from cg.problems.taylor import QuadraticSystem, reference_solution

READINGS = ["momentum", "velocity"]
TENTHS = [Fraction(k, 10) for k in range(11)]


@pytest.fixture(scope="module", params=READINGS)
def top(request):
    return HeavyTop(request.param)


@pytest.fixture(scope="module")
def reference(top):
    return top.reference(TENTHS)


def test_constants_and_initial_values():
    top = HeavyTop()
    rotation, m = top.frame.split(top.y0)
    cosine, sine = np.cos(np.pi / 16), np.sin(np.pi / 16)
    expected = [[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]]
    np.testing.assert_allclose(rotation, expected, rtol=0, atol=1e-16)
    np.testing.assert_array_equal(hat(m), [[0, -1, 0], [1, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(HeavyTop("velocity").y0[9:], [0, 0, 0.25])
    assert top.frame == Product(SO3(), Euclidean(3))
    assert float(top.mgl) == pytest.approx(9.81 * np.sqrt(3) / 2, rel=2e-16)
    assert abs(top.mgl**2 - Fraction(981, 100) ** 2 * 3 / 4) < Fraction(1, 2**200)
    exact = top.y0_exact
    assert abs(exact[4] ** 2 + exact[5] ** 2 - 1) < Fraction(1, 2**200)
    half_angle = 2 * exact[4] ** 2 - 1  # cos(pi / 8), whose double angle is known
    assert abs((2 * half_angle**2 - 1) ** 2 - Fraction(1, 2)) < Fraction(1, 2**200)


def test_reference_estimates_its_error(reference):
    assert max(reference.errors) <= 1e-33
    assert reference.times == tuple(TENTHS)
    assert reference.y.shape == (11, 12)


def test_reference_keeps_the_invariants_beyond_quadruple_precision(top, reference):
    inverse = [1 / moment for moment in top.inertia]

    def invariants(y):
        m = y[9:]
        energy = sum(i * x * x for i, x in zip(inverse, m, strict=True)) / 2 + top.mgl * y[8]
        vertical = sum(x * z for x, z in zip(m, y[6:9], strict=True))
        gram = [
            sum(y[3 * i + k] * y[3 * j + k] for k in range(3)) - (i == j)
            for i in range(3)
            for j in range(3)
        ]
        return (energy, vertical, m[2], *gram)

    start = invariants(top.y0_exact)
    for y in reference.values:
        for now, then in zip(invariants(y), start, strict=True):
            assert abs(now - then) < Fraction(1, 10**33)


def test_taylor_series_of_known_solutions():
    def build():
        # y' = -y^2 and z' = 1, w' = -w: y = 1/(1 + t), z = t, w = exp(-t)
        equations = (((arb(-1), (0, 0)),), ((arb(1), ()),), ((arb(-1), (2,)),))
        return QuadraticSystem(equations, (arb(1), arb(0), arb(1)))

    solution = reference_solution(build, [Fraction(1, 2), 3])
    for t, (y, z, w), error in zip(solution.times, solution.values, solution.errors, strict=True):
        assert abs(y - 1 / (1 + t)) < 1e-40
        assert abs(z - t) < 1e-60
        assert float(w) == pytest.approx(np.exp(-float(t)), rel=1e-15)
        assert error < 1e-40
