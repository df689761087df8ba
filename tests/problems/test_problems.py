"""The problems: equations against their ambient form, invariants, and oracles; orders on frames."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from cg.analysis.convergence import observed_order
from cg.catalogue import methods
from cg.frames import SE3
from cg.integration import integrate
from cg.problems import (
    AffineField,
    ConingMotion,
    ForcedRigidBody,
    FreeRigidBody,
    GradientFlow,
    GyroAttitude,
    HeavyTop,
    ReactionWheels,
    Spacecraft,
    TodaFlow,
    TwoLevelSystem,
)
from cg.reproduce.reference_runs import integrate_heavy_top

CONING = ConingMotion()


GYRO = CONING.sampled(np.linspace(0.0, 1.0, 401))


SPACECRAFT = {"free": Spacecraft(), "controlled": Spacecraft(stiffness=1.0, damping=0.5)}


WITH_TAYLOR = {
    "rigid body": FreeRigidBody(),
    "spacecraft": SPACECRAFT["free"],
    "controlled spacecraft": SPACECRAFT["controlled"],
    "forced body": ForcedRigidBody(),
    "reaction wheels": ReactionWheels(),
}


LATTICE = GradientFlow((2, 2))


# The solution at time 1, by an oracle that knows no Crouch-Grossman method.
ENDS = {
    **{name: lambda p: p.reference([1], bits=128).y[0, : len(p.y0)] for name in WITH_TAYLOR},
    "gyro": lambda p: CONING.attitude(1.0),
    "Toda": lambda p: p.exact(1.0),
    "two levels": lambda p: p.exact(1.0),
    "gradient flow": lambda p: p.reference([1]).y.view(complex).reshape(p.y0.shape),
}


PROBLEMS = {
    **WITH_TAYLOR,
    "gyro": GYRO,
    "Toda": TodaFlow(),
    "two levels": TwoLevelSystem(),
    "gradient flow": LATTICE,
}


STEPS = {"Toda": (32, 64, 128)}


def ambient(problem, times, start=0.0):
    """Solve in the space around by SciPy."""
    shape, frame = problem.y0.shape, problem.frame

    def right(t, y):
        y = y.reshape(shape)
        return frame.field(problem.f(t, y), y).ravel()

    y0 = problem.y0.ravel()
    options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
    found = solve_ivp(right, (start, times[-1]), y0, t_eval=times, **options)
    return found.y.T.reshape(-1, *shape)


@pytest.mark.parametrize("name", list(PROBLEMS))
def test_observed_orders_against_references(name):
    problem = PROBLEMS[name]
    exact = ENDS[name](problem)
    for method in ("CG3", "CG4a"):
        steps = np.array(STEPS.get(name, (16, 32, 64)))
        errors = [
            np.abs(
                integrate(
                    problem.f, (0, 1), problem.y0, frame=problem.frame, method=method, h=1 / n
                ).y[-1]
                - exact
            ).max()
            for n in steps.tolist()
        ]
        assert errors[0] < 1e-3
        order = observed_order(1.0 / steps, errors).order
        assert order == pytest.approx(methods[method].order, abs=0.25), method


@pytest.mark.parametrize("name", list(PROBLEMS))
def test_invariants_and_manifold(name):
    problem = PROBLEMS[name]
    solution = integrate(
        problem.f, (0, 1), problem.y0, frame=problem.frame, method="CG5a", h=1 / 128
    )
    assert problem.frame.membership_error(solution.y).max() < 1e-14
    start = problem.invariants(problem.y0)
    for key, values in problem.invariants(solution.y).items():
        assert values.shape == (129, *np.shape(start[key]))
        if (name, key) != ("controlled spacecraft", "energy"):
            np.testing.assert_allclose(values, np.broadcast_to(start[key], values.shape), atol=1e-7)


@pytest.mark.parametrize("name", list(WITH_TAYLOR))
def test_taylor_references(name):
    problem = WITH_TAYLOR[name]
    times = [0.5, 1.5]
    found = problem.reference(times, bits=128)
    assert max(found.errors) < 1e-30
    y = found.y[:, : len(problem.y0)]
    np.testing.assert_allclose(y, ambient(problem, times), rtol=0, atol=1e-11)
    if name != "controlled spacecraft":
        for key, values in problem.invariants(y).items():
            start = np.broadcast_to(problem.invariants(problem.y0)[key], values.shape)
            np.testing.assert_allclose(values, start, rtol=0, atol=4e-15)
    back = problem.reference([Fraction(-1, 2)], bits=128)
    assert problem.frame.membership_error(back.y[0, : len(problem.y0)]) < 1e-15


@pytest.mark.parametrize("inertia", list(itertools.permutations((3.0, 2.0, 1.25))))
@pytest.mark.parametrize(
    "momentum",
    [(0.6, 1.0, 1.5), (-0.6, 1, 1.5), (1.5, -0.3, -0.2), (0.1, -0.2, -1), (1, 1, 1), (0, 1, 1e-3)],
)
def test_elliptic_functions_solve_eulers_equations(inertia, momentum):
    body = FreeRigidBody(inertia, momentum)
    times = np.array([-3.0, 0.0, 0.5, 7.0, 20.0])
    found = body.exact_momentum(times)
    # The last of the momenta is near the separatrix, where the phase is ill conditioned.
    np.testing.assert_allclose(found[1], momentum, rtol=0, atol=4e-14)
    for t, m in zip(times, found, strict=True):
        wanted = solve_ivp(
            lambda t, m: np.cross(m, m / np.array(inertia)),
            (0, t),
            body.momentum,
            method="DOP853",
            rtol=1e-13,
            atol=1e-14,
        ).y[:, -1]
        np.testing.assert_allclose(m, wanted, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("inertia", "momentum"),
    [
        ((2, 2, 1), (0.3, 0.5, -0.7)),
        ((1, 2, 2), (0.3, 0.5, -0.7)),
        ((1, 1, 1), (0.3, 0.5, -0.7)),
        ((1, 2, 1.5), (0, 0, 2.0)),
        ((1, 2, 1.5), (0, -1.0, 0)),
        ((1, 2, 1.5), (1.0, 0, 0)),
    ],
)
def test_elliptic_functions_of_symmetric_bodies_and_steady_rotations(inertia, momentum):
    body = FreeRigidBody(inertia, momentum)
    times = [1.0, 5.0]
    m = body.body_momentum(ambient(body, times))
    np.testing.assert_allclose(body.exact_momentum(times), m, rtol=0, atol=1e-11)


def test_elliptic_functions_agree_with_the_taylor_series():
    body = FreeRigidBody()
    times = [0.25, 1, 4]
    reference = body.reference(times, bits=128).y
    exact = body.exact_momentum(times)
    np.testing.assert_allclose(exact, body.body_momentum(reference), rtol=0, atol=2e-15)


def test_spacecraft_equation_in_vector_form():
    craft = Spacecraft(stiffness=0.5, damping=0.25, orbit_rate=0.75)
    rng = np.random.default_rng(4)
    for y in craft.frame.random_point(rng, (4,)):
        q, omega = craft.frame.split(y)
        axes = Rotation.from_quat(q).as_matrix()
        inertia = np.diag(craft.inertia)
        relative = omega - 0.75 * axes[2]
        torque = np.cross(inertia @ omega, omega)
        torque += 3 * 0.75**2 * np.cross(axes[0], inertia @ axes[0])
        torque += -0.5 * q[:3] - 0.25 * relative
        wanted = np.concatenate([relative, np.linalg.solve(inertia, torque)])
        np.testing.assert_allclose(craft.f(0.0, y), wanted, rtol=0, atol=1e-13)


def test_control_brings_the_spacecraft_to_rest_and_damping_takes_energy():
    craft = Spacecraft(stiffness=4.0, damping=4.0)
    solution = integrate(craft.f, (0, 30), craft.y0, frame=craft.frame, method="CG4a", h=0.05)
    np.testing.assert_allclose(np.abs(solution.y[-1, :4]), [0, 0, 0, 1], rtol=0, atol=1e-5)
    np.testing.assert_allclose(solution.y[-1, 4:], [0, 0, craft.orbit_rate], rtol=0, atol=1e-5)
    energy = craft.invariants(solution.y)["energy"]
    assert (np.diff(energy) < 1e-12).all()
    springy = Spacecraft(stiffness=2.0)
    solution = integrate(springy.f, (0, 1), springy.y0, frame=springy.frame, method="CG5a", h=0.01)
    energy = springy.invariants(solution.y)["energy"]
    np.testing.assert_allclose(energy, energy[0], rtol=0, atol=1e-8)


def test_coning_is_a_solution():
    t, h = 0.7, 1e-5
    q = CONING.attitude([t - h, t, t + h])
    turn = Rotation.from_quat(q[0]).inv() * Rotation.from_quat(q[2])
    np.testing.assert_allclose(turn.as_rotvec() / (2 * h), CONING.rate(t), rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=0, atol=1e-15)


def test_gyro_interpolation_is_of_order_four():
    errors = []
    for n in (20, 40, 80):
        gyro = CONING.sampled(np.linspace(0, 2, n + 1))
        found = integrate(gyro.f, gyro.t_span, gyro.y0, frame=gyro.frame, method="CG5a", h=1 / 128)
        errors.append(gyro.frame.distance(found.y[-1], CONING.attitude(2.0)))
    order = observed_order([1 / 20, 1 / 40, 1 / 80], errors).order
    assert order > 3.7


def test_irregular_samples_that_start_later():
    rng = np.random.default_rng(3)
    times = 5.0 + np.cumsum(rng.uniform(0.001, 0.009, 400))
    gyro = CONING.sampled(times)
    found = integrate(gyro.f, gyro.t_span, gyro.y0, frame=gyro.frame, method="CG4a", h=0.01)
    assert gyro.frame.distance(found.y[-1], CONING.attitude(times[-1])) < 1e-6
    with pytest.raises(ValueError, match="t must lie between 5"):
        gyro.f(4.9, gyro.y0)


def test_toda_keeps_the_spectrum_and_sorts_it():
    toda = TodaFlow()
    late = toda.exact(60.0)
    values = np.linalg.eigvalsh(toda.y0)
    np.testing.assert_allclose(np.diag(late), values[::-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(late - np.diag(np.diag(late)), 0.0, rtol=0, atol=1e-12)
    middle = toda.exact([0.0, 1.0, -2.0])
    np.testing.assert_allclose(middle[0], toda.y0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.triu(middle, 2), 0.0, rtol=0, atol=1e-12)
    full = TodaFlow([[1.0, 2.0, 0.5], [2.0, -1.0, 0.25], [0.5, 0.25, 0.0]])
    np.testing.assert_allclose(full.exact(0.5), ambient(full, [0.5])[0], rtol=0, atol=1e-11)


def test_two_level_system_matches_rabis_formula():
    for system in (TwoLevelSystem(), TwoLevelSystem(2.0, 1.0, 2.0), TwoLevelSystem(1.0, 0.0, 1.0)):
        times = np.array([0.0, 0.5, 4.0])
        population = np.abs(system.exact(times)[:, 1, 0]) ** 2
        np.testing.assert_allclose(
            population, system.transition_probability(times), rtol=0, atol=1e-15
        )
    system = TwoLevelSystem()
    h = 1e-5
    slope = (system.exact(0.7 + h) - system.exact(0.7 - h)) / (2 * h)
    wanted = system.frame.field(system.f(0.7, None), system.exact(0.7))
    np.testing.assert_allclose(slope, wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["rigid body", "spacecraft", "Toda"])
def test_f_accepts_batches(name):
    problem = PROBLEMS[name]
    points = problem.frame.random_point(np.random.default_rng(2), (2, 3))
    together = problem.f(0.0, points)
    for index in np.ndindex(2, 3):
        alone = problem.f(0.0, points[index])
        np.testing.assert_allclose(together[index], alone, rtol=1e-13, atol=1e-13)


def run(**changes):
    valid = {"problem": HeavyTop(), "method": "CG3", "h": 0.1, "steps": 10}
    return integrate_heavy_top(**valid | changes)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (
            lambda: FreeRigidBody((1, 1, 3)),
            ValueError,
            "inertia must be positive, none larger than",
        ),
        (lambda: FreeRigidBody((1, 1, -1)), ValueError, "inertia must be positive"),
        (lambda: FreeRigidBody((1, 1)), ValueError, "inertia must be 3 finite numbers"),
        (lambda: FreeRigidBody(momentum=(0, 0, 0)), ValueError, "momentum must not vanish"),
        (lambda: FreeRigidBody(momentum=(0, 0, np.nan)), ValueError, "momentum must be 3 finite"),
        (lambda: FreeRigidBody().exact_momentum(np.inf), ValueError, "t must be finite"),
        (lambda: Spacecraft(attitude=(0, 0, 0, 0)), ValueError, "attitude must not vanish"),
        (lambda: Spacecraft(orbit_rate=[1, 2]), ValueError, "orbit_rate must be a finite number"),
        (lambda: TodaFlow([[1, 2], [3, 4]]), ValueError, "initial must be a finite symmetric"),
        (lambda: TodaFlow([[np.nan]]), ValueError, "initial must be a finite symmetric matrix"),
        (lambda: TwoLevelSystem(drive=np.inf), ValueError, "drive must be a finite number"),
        (lambda: ConingMotion(angle=np.nan), ValueError, "angle must be a finite number"),
        (lambda: CONING.sampled([0, 1, 2]), ValueError, "times must be at least four finite"),
        (lambda: CONING.sampled([0, 1, 1, 2]), ValueError, "times must increase"),
        (
            lambda: GyroAttitude([0, 1, 2, 3], np.zeros((3, 3))),
            ValueError,
            r"rates must have shape \(4, 3\), got \(3, 3\)",
        ),
        (
            lambda: GyroAttitude([0, 1, 2, 3], [[0, 0, 0], [0, 0, np.nan], *np.zeros((2, 3))]),
            ValueError,
            r"rates must be finite, got nan at \[1, 2\]",
        ),
        (
            lambda: GyroAttitude([0, 1, 2, 3], np.zeros((4, 3)), [1, 1, 0, 0]),
            ValueError,
            "initial must be a point of UnitQuaternion",
        ),
        (lambda: GradientFlow((2,)), ValueError, "sides must be two or more positive integers"),
        (lambda: GradientFlow(3), ValueError, "sides must be two or more positive integers"),
        (lambda: GradientFlow((2, 0)), ValueError, r"sides\[1\] must be at least 1"),
        (lambda: GradientFlow(roughness=np.nan), ValueError, "roughness must be a finite number"),
        (lambda: GradientFlow(seed=-1), ValueError, "seed must be at least 0"),
        (lambda: LATTICE.action(np.eye(3)), ValueError, "y must have shape"),
        (lambda: HeavyTop("speed"), ValueError, "reading must be"),
        (lambda: HeavyTop("momentum", "third"), ValueError, "phi_over_pi must be rational"),
        (lambda: HeavyTop("momentum", np.nan), ValueError, "phi_over_pi must be rational"),
        *(
            (lambda t=t: HeavyTop().reference([t]), ValueError, "times must be finite numbers")
            for t in ("noon", np.nan, np.inf, None)
        ),
        (lambda: run(problem=FreeRigidBody()), TypeError, "problem must be a HeavyTop"),
        (lambda: run(method="CG0"), ValueError, "method must be one of"),
        (lambda: run(h=0), ValueError, "h must be positive, got 0"),
        (lambda: run(h=-0.1), ValueError, "h must be positive"),
        *(
            (lambda h=h: run(h=h), ValueError, "h must be a finite number")
            for h in (np.nan, "1/0", None)
        ),
        (lambda: run(steps=0), ValueError, "steps must be at least 1, got 0"),
        (lambda: run(steps=2.0), TypeError, "steps must be an integer"),
        (lambda: run(kind="real16"), ValueError, 'kind must be "real64" or "real128"'),
    ],
)
def test_bad_arguments_are_rejected(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_affine_field_on_a_batch():
    problem = AffineField(SE3(), np.eye(4))
    points = problem.frame.random_point(np.random.default_rng(1), (2, 3))
    found = problem.f(0.5, points)
    assert found.shape == (2, 3, 6)
    np.testing.assert_allclose(found[1, 2], problem.f(0.5, points[1, 2]), rtol=0, atol=1e-15)
