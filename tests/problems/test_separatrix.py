"""The free rigid body near and on the separatrix, where it turns over after ever longer times."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cg.problems import FreeRigidBody

ORDERS = list(itertools.permutations(range(3)))


def near_the_separatrix(rng, order, distance):
    """A body of which 2 E I_j is |m|^2 but for a relative distance and rounding."""
    inertia, m = np.sort(rng.uniform(1.0, 2.0, 3)), rng.standard_normal(3)
    a = 1.0 / inertia
    m[2] = np.copysign(m[0] * np.sqrt((a[0] - a[1]) / (a[1] - a[2])), m[2]) * (1.0 + distance)
    return FreeRigidBody(tuple(inertia[list(order)]), tuple(m[list(order)]))


def integrated(body, t):
    return solve_ivp(
        lambda t, m: np.cross(m, m / np.array(body.inertia)),
        (0, t),
        body.momentum,
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    ).y[:, -1]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("distance", [0.0, 1e-15, -1e-15, 1e-13, -1e-11, 1e-8, -1e-5, 1e-2])
def test_bodies_near_the_separatrix(order, distance):
    rng = np.random.default_rng(201)
    times = np.array([-4.0, 0.0, 0.5, 4.0, 1e3, 1e6])
    for _ in range(4):
        body = near_the_separatrix(rng, order, distance)
        found = body.exact_momentum(times)
        size, rounding = body.size, 4e-15 * (1.0 + np.abs(times) * body.size)
        assert (np.abs(np.linalg.norm(found, axis=-1) - size) <= 4e-15 * size).all()
        energy = (found**2 / np.array(body.inertia)).sum(axis=-1)
        np.testing.assert_allclose(energy, energy[1], rtol=8e-15)
        assert (np.abs(found[1] - body.momentum) <= rounding[1] * size).all()
        for t, m in zip(times[:4], found, strict=False):
            # DOP853 errs by some hundred roundings, which grow by up to e^(t / 2) here.
            np.testing.assert_allclose(m, integrated(body, t), rtol=0, atol=2e-12 * size)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("signs", list(itertools.product((1.0, -1.0), repeat=3)))
def test_on_the_separatrix_itself(order, signs):
    inertia = np.array([3.0, 4.0, 6.0])[list(order)]
    momentum = (np.array([1.0, 0.75, 1.0]) * signs)[list(order)]
    body = FreeRigidBody(tuple(inertia), tuple(momentum))
    times = np.array([-3.0, 0.0, 0.5, 4.0])
    found = body.exact_momentum(times)
    for t, m in zip(times, found, strict=True):
        np.testing.assert_allclose(m, integrated(body, t), rtol=0, atol=2e-12)
    # It ends in the rotation about the middle axis, one way or the other, and stays there.
    middle = np.abs(body.exact_momentum([-1e5, 1e5]))
    wanted = np.where(inertia == 4.0, body.size, 0.0)
    np.testing.assert_allclose(middle, [wanted, wanted], rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("distance", [1e-15, -1e-12])
def test_turnovers_next_to_the_separatrix(distance):
    """Their time is the logarithm of the distance, which must have its digits."""
    slow = near_the_separatrix(np.random.default_rng(202), (2, 0, 1), distance)
    body = FreeRigidBody(slow.inertia, tuple(32.0 * x for x in slow.momentum))
    times = [4.0, -5.0]
    wanted = body.body_momentum(body.reference(times, bits=128).y[:, :12])
    np.testing.assert_allclose(body.exact_momentum(times), wanted, rtol=0, atol=1e-12)


def test_next_to_the_steady_rotation_about_the_middle_axis():
    body = FreeRigidBody((2.0, 3.0, 4.0), (1e-100, 1.0, 1e-100))
    found = body.exact_momentum(np.linspace(-3e4, 3e4, 999))
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, rtol=2e-15)
    assert found[:, 1].min() < -0.99
    assert found[:, 1].max() > 0.99
    for tiny in (1e-160, 1e-320):
        body = FreeRigidBody((2.0, 3.0, 4.0), (tiny, 1.0, tiny))
        with pytest.raises(ValueError, match="is too near the separatrix to be computed"):
            body.exact_momentum(1.0)


@pytest.mark.parametrize("power", [-600, 600])
def test_the_size_of_the_momentum_is_that_of_time(power):
    times, factor = np.array([-2.0, 0.0, 5.0]), 2.0**power
    body = FreeRigidBody((2.0, 3.0, 4.0), (0.6, 1.0, 1.5))
    scaled = FreeRigidBody(body.inertia, tuple(factor * m for m in body.momentum))
    wanted = factor * body.exact_momentum(times)
    np.testing.assert_array_equal(scaled.exact_momentum(times / factor), wanted)
