"""Forces that are linear in the velocity: rotors, magnetic fields, turning frames."""

import numpy as np
import pytest
from mechanics import INERTIA, MATRIX, system
from refusals import refuses

import cg
from cg.frames import SO3, SU, Euclidean, PhaseSpace, Power, Product, Sphere, UnitQuaternion

ROTOR = [0.4, -0.7, 0.9]
FIELD = [[0.0, 1.3, 0.2], [-1.3, 0.0, -0.5], [-0.2, 0.5, 0.0]]


def gyroscopic(configuration, inertia, matrix, seed=5):
    """Return a system of `mechanics` with a force of the matrix."""
    plain = system(configuration, inertia, seed)
    plain.frame = PhaseSpace(configuration, inertia, gyroscopic=matrix)
    return plain


CASES = {
    "rotor": (SO3(), INERTIA, ROTOR, 6),
    "rotor and matrix": (UnitQuaternion(), MATRIX, ROTOR, 6),
    "field": (Euclidean(3), MATRIX, FIELD, 6),
    "both": (Product(SO3(), Euclidean(2)), (INERTIA, 2.0), (ROTOR, [[0, -1], [1, 0]]), 6),
}


@pytest.mark.parametrize("name", CASES)
def test_slopes_are_orders(name):
    *case, order = CASES[name]
    top = gyroscopic(*case)
    reference = top.reference((0, 1)).y[-1]
    errors = [np.abs(top.run("BlanesMoan6", h=h).y[-1] - reference).max() for h in (0.5, 0.25)]
    assert np.log2(errors[0] / errors[1]) > order - 0.6
    back = top.run("BlanesMoan6", (1, 0), y0=top.run("BlanesMoan6", h=0.25).y[-1], h=0.25)
    assert np.allclose(back.y[-1], top.y0, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize(("configuration", "inertia", "matrix"), [
    (SO3(), 2.0, ROTOR), (UnitQuaternion(), [2.0, 1.5, 2.0], [0.0, 0.8, 0.0]),
    (Euclidean(3), INERTIA, FIELD), (Power(Euclidean(3), 2), 2.0, FIELD),
])  # fmt: skip
def test_motion_without_other_forces_is_exact_where_it_can_be(configuration, inertia, matrix):
    frame = PhaseSpace(configuration, inertia, gyroscopic=matrix)
    y0 = frame.random_point(np.random.default_rng(1))

    def none(t, y):
        return np.zeros(frame.rhs_dim)

    one = cg.solve_ivp(none, (0, 20), y0, frame=frame, method="Leapfrog", h=20.0).y[-1]
    other = cg.solve_ivp(none, (0, 20), y0, frame=frame, method="DOP853", rtol=1e-12, atol=1e-12)
    assert np.allclose(one, other.y[-1], rtol=0.0, atol=2e-11)
    assert np.isclose(frame.kinetic_energy(one), frame.kinetic_energy(y0), rtol=4e-14, atol=0.0)


def test_a_gyrostat_keeps_its_integrals():
    """Its energy, and the momentum of body and rotor in space."""
    frame = PhaseSpace(SO3(), INERTIA, gyroscopic=ROTOR)
    y0 = frame.join(np.eye(3), [0.5, 0.1, 1.0])
    run = cg.solve_ivp(
        lambda t, y: np.zeros(3), (0, 2000), y0, frame=frame, method="Leapfrog", h=0.4
    )  # fmt: skip
    q, momentum = frame.split(run.y)
    total = (q @ (momentum + ROTOR)[..., None])[..., 0]
    assert np.allclose(total, total[0], rtol=0.0, atol=1e-12)
    error = np.abs(frame.kinetic_energy(run.y) / frame.kinetic_energy(y0) - 1)
    tenth = len(error) // 10
    assert error.max() < 1e-5
    assert error[-tenth:].max() < 1.5 * error[:tenth].max()


def test_frames_and_members():
    frame = PhaseSpace(SO3(), INERTIA, gyroscopic=ROTOR)
    assert eval(repr(frame)) == frame != PhaseSpace(SO3(), INERTIA)
    y = frame.random_point(np.random.default_rng(2), 3)
    slope = frame.complete_rhs(np.zeros((3, 3)), y) - PhaseSpace(SO3(), INERTIA).complete_rhs(
        np.zeros((3, 3)), y
    )
    assert np.allclose(slope[:, 3:], np.cross(ROTOR, frame.velocity(y)), rtol=0.0, atol=1e-15)
    top = gyroscopic(SO3(), INERTIA, ROTOR)
    both = cg.solve_ensemble(
        top.f, (0, 1), top.y0, frame=top.frame, inertia=[INERTIA, MATRIX], method="Leapfrog", h=0.1
    )
    for k, inertia in enumerate([INERTIA, MATRIX]):
        alone = gyroscopic(SO3(), inertia, ROTOR).run("Leapfrog", h=0.1, y0=top.y0)
        assert np.allclose(both.y[-1, k], alone.y[-1], rtol=0.0, atol=2e-14)


@pytest.mark.parametrize(("frame", "matrix", "message"), [
    (SO3("space"), ROTOR, "must be None on SO3.*rotor"),
    (SU(3), np.zeros((8, 8)), "must be None on SU"),
    (Sphere(2), ROTOR, "must be None on Sphere"),
    (SO3(), np.eye(3), "must be antisymmetric.*friction is that of thermostat"),
    (SO3(), np.ones((2, 2)), r"must have shape \(3, 3\), got \(2, 2\)"),
    (Product(SO3(), SO3()), ROTOR, "must be a tuple of 2"),
])  # fmt: skip
def test_what_is_refused(frame, matrix, message):
    refuses(ValueError, message, PhaseSpace, frame, None, gyroscopic=matrix)


def test_derivatives_by_splitting_are_refused():
    top = gyroscopic(SO3(), INERTIA, ROTOR)
    options = {"h": 0.1, "derivatives": "forward"}
    refuses(ValueError, "gyroscopic", top.run, "Leapfrog", **options)
    assert top.run("CF5(4)", **options).transition.shape[1:] == (6, 6)
