"""The free motion of rigid bodies by one step of a splitting method without forces."""

import ctypes
from fractions import Fraction

import numpy as np
import pytest
from flint import arb
from mechanics import INERTIA, MATRIX
from scipy import LowLevelCallable
from scipy.spatial.transform import Rotation
from slow_cases import slow

import cg
from cg.frames import SO3, PhaseSpace
from cg.problems.taylor import QuadraticSystem, solve_at
from cg.support.quads import working_precision

pytestmark = pytest.mark.sanitize

EPSILON = np.finfo(np.float64).eps


def exact_motion(inertia, momentum, time):
    """Return attitude and momentum by Taylor series of 200 bits, in steps of a radian."""
    with working_precision(200):
        inverse = [1 / arb(float(moment)) for moment in inertia]
        # columns of the attitude's transpose change as the momentum does: x' = x cross omega
        equations = tuple(
            ((inverse[k], (at + j, k)), (-inverse[j], (at + k, j)))
            for at in range(0, 12, 3)
            for j, k in ((1, 2), (2, 0), (0, 1))
        )
        initial = tuple(arb(float(x)) for x in (*momentum, *np.eye(3).ravel()))
        system, at = QuadraticSystem(equations, initial), Fraction(float(time))
        fastest = np.sqrt(np.sum(np.square(momentum) / inertia) / min(inertia))
        (end,) = solve_at(system, (at,), Fraction(1.0 / fastest), 60)
        vectors = np.array(end, dtype=float).reshape(4, 3)
        return vectors[1:], vectors[0]


def no_force(t, y):
    return [0.0, 0.0, 0.0]


def drift(momentum, time, inertia, configuration=None, steps=1):
    """Return attitude and momentum in body axes after free motion from the identity."""
    frame = PhaseSpace(configuration or SO3(), inertia)
    identity = np.eye(3) if frame.configuration.point_shape == (3, 3) else [0.0, 0.0, 0.0, 1.0]
    run = cg.integrate(
        no_force, (0.0, time), frame.join(identity, momentum), frame=frame, method="Leapfrog",
        h=abs(time) / steps,
    )  # fmt: skip
    return frame.split(run.y[-1])


def angle(rng, momentum, inertia, low, high):
    """Return a time in which a body turns by 10^low to 10^high radians, forward or backward."""
    rate = np.linalg.norm(np.divide(momentum, inertia))
    return rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(low, high) / rate


def any_body(rng):
    inertia = np.exp(rng.normal(size=3) * rng.choice([0.1, 1.0]))
    momentum = rng.normal(size=3)
    return inertia, momentum, angle(rng, momentum, inertia, -3, 1)


def symmetric(rng):
    inertia = np.ones(3)
    inertia[rng.integers(3)] = rng.choice([0.3, 1.7, 2.0])
    momentum = rng.normal(size=3)
    return inertia, momentum, angle(rng, momentum, inertia, -3, 1)


def transverse(rng):
    inertia, _, time = symmetric(rng)
    small = rng.choice([0.0, 1e-162, 1e-12]) * rng.normal()
    momentum = np.where(inertia == 1.0, rng.normal(size=3), small)
    return inertia, momentum, time


def almost_spherical(rng):
    inertia = 1.0 + 10.0 ** rng.integers(-16, -1) * rng.normal(size=3)
    momentum = rng.normal(size=3)
    return inertia, momentum, angle(rng, momentum, inertia, -2, 1)


def near_an_axis(rng):
    inertia = rng.permutation(INERTIA)
    momentum = rng.choice([0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-3]) * rng.normal(size=3)
    momentum[rng.integers(3)] = rng.choice([-1.0, 1.0])
    # on the second axis the motion is unstable; conditions of more than ten are not tested
    second = np.argsort(inertia)[1]
    longest = 0.5 if abs(momentum[second]) == 1.0 else 1
    return inertia, momentum, angle(rng, momentum, inertia, -2, longest)


def near_the_separatrix(rng):
    inverse = np.reciprocal(INERTIA)
    third = np.sqrt((inverse[0] - inverse[1]) / (inverse[1] - inverse[2]))
    off = 10.0 ** rng.integers(-17, -3) * rng.normal()
    momentum = np.array([1.0, rng.normal(), third * (1.0 + off)]) * rng.choice([-1, 1], size=3)
    return np.array(INERTIA), momentum, angle(rng, momentum, INERTIA, -2, 0.7)


def slender(rng):
    inertia = rng.permutation([1.0, 1e3, 1.5e3])
    momentum = inertia * rng.normal(size=3)
    return inertia, momentum, angle(rng, momentum, inertia, -2, 0)


REGIMES = [
    any_body, symmetric, transverse, almost_spherical, near_an_axis, near_the_separatrix, slender
]  # fmt: skip


@pytest.mark.parametrize("regime", REGIMES, ids=lambda regime: regime.__name__)
def test_the_error_is_rounding(regime):
    for seed in range(12):
        inertia, momentum, time = regime(np.random.default_rng([seed, len(regime.__name__)]))
        attitude, exact = exact_motion(inertia, momentum, time)
        q, after = drift(momentum, time, inertia)
        rate = max(np.linalg.norm(np.divide(m, inertia)) for m in (momentum, after))
        allowed = 10.0 * EPSILON * (1.0 + rate * abs(time))
        assert np.abs(q - attitude).max() <= allowed, (seed, inertia, momentum, time)
        error = np.abs(after - exact).max() / np.linalg.norm(momentum)
        assert error <= allowed, (seed, inertia, momentum, time)


@pytest.mark.parametrize("size", [1e-200, 1e-20, 1e200])
def test_spins_of_any_size_turn_alike(size):
    momentum = np.array([0.3, 0.9, -0.4])
    q, after = drift(momentum, 5.0, INERTIA)
    other, scaled = drift(size * momentum, 5.0 / size, INERTIA)
    assert np.abs(q - other).max() < 1e-14
    assert np.abs(after - scaled / size).max() < 1e-14


def test_spins_whose_phase_has_no_digit_end_at_once():
    with pytest.raises(OverflowError, match="no longer finite"):
        drift(np.array([0.3e50, 0.9e50, -0.4e50]), 5.0, INERTIA)


@pytest.mark.parametrize("inertia", [INERTIA, [1.0, 1.0, 2.0], [1.0, 1.1, 5.0], MATRIX])
@pytest.mark.parametrize("h", [0.03, 1.3])
def test_invariants_have_rounding_errors_without_bias(compiled_library, inertia, h):
    force, c = compiled_library["heavy"], np.zeros(3)
    force.restype = ctypes.c_int
    force.argtypes = [ctypes.c_double, *2 * [ctypes.POINTER(ctypes.c_double)], ctypes.c_void_p]
    f = LowLevelCallable(force, ctypes.c_void_p(c.ctypes.data))
    frame, steps = PhaseSpace(SO3(), inertia), 10**5
    y0 = frame.join(np.eye(3), [0.3, 0.9, -0.4])
    run = cg.solve_ivp(
        f, (0.0, steps * h), y0, frame=frame, method="Leapfrog", h=h, t_eval=[steps * h]
    )
    q, momentum = frame.split(run.y[0])
    energy = frame.kinetic_energy(run.y[0]) / frame.kinetic_energy(y0) - 1.0
    # far less than errors of one ulp a step would be, if they added up
    assert abs(energy) < 0.05 * steps * EPSILON
    assert np.abs(q @ momentum - y0[9:]).max() < 0.05 * steps * EPSILON


@pytest.mark.parametrize("last", [2.0, 2.0 + 4e-16, 2.0 - 4e-16, 2.0 + 1e-12])
@pytest.mark.parametrize("h", [2.0, 3.0, 8.0, -5.0, 320.0, *slow(1e7)])
def test_momenta_keep_their_length_near_the_separatrix(h, last):
    """They leave and meet the axis in the middle as exp(t), where rounding would grow as well."""
    frame = PhaseSpace(cg.frames.UnitQuaternion(), [1 / 16, 1 / 4, 1.0])
    momentum = np.array([1.0, 1.0, last])
    options = {"frame": frame, "method": "Leapfrog", "h": abs(h)}
    start = frame.join([0.0, 0.0, 0.0, 1.0], momentum)
    end = cg.integrate(lambda t, q: np.zeros(3), (0, h), start, **options).y[-1]
    q, after = frame.split(end)
    for row in (lambda m: m @ m, lambda m: m @ (m * [16.0, 4.0, 1.0])):
        assert np.isclose(row(after), row(momentum), rtol=4e-15, atol=0.0)
    turned = Rotation.from_quat(q).apply(after.copy())
    np.testing.assert_allclose(turned, momentum, rtol=0.0, atol=3e-16 * (20 + 16 * abs(h)))


def test_rotors_that_turn_too_often_end_at_once():
    turning = [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]
    frame = PhaseSpace(cg.frames.Euclidean(3), [1.0] * 3, gyroscopic=turning)
    for h in (1e7, 3e9):
        with pytest.raises(OverflowError, match="no longer finite"):
            cg.integrate(lambda t, q: np.zeros(3), (0, h), [0, 0, 0, 1.0, 0, 0], frame=frame,
                         method="Leapfrog", h=h)  # fmt: skip
