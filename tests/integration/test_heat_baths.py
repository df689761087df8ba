"""Heat baths: streams of noise, equilibrium, and what is refused."""

import pickle

import numpy as np
import pytest
from mechanics import INERTIA, MATRIX, system
from refusals import refuses

import cg
from cg import frames as fr

BATH = cg.Langevin(friction=1.0, temperature=0.7, seed=11)
STEPS = {"method": "Leapfrog", "h": 0.25}


def unforced(t, y):
    return np.zeros((*y.shape[:-1], 12))


def spring(t, y):
    return -y[..., :1]


def variates(seed, member, tick, count):
    """Return normal variates of NumPy's generator with the same definition."""
    rows = []
    for block in range(-(-count // 4)):
        place = tick + (block << 64) - 1  # NumPy adds one before the first words
        words = np.random.Philox(key=seed + (member << 64), counter=place % 2**256).random_raw(4)
        uniform = (words >> np.uint64(11)).astype(float) / 2**53
        radius = np.sqrt(-2.0 * np.log(uniform[::2] + 0.5**54))
        angle = 2 * np.pi * uniform[1::2]
        rows.append(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).ravel())
    return np.concatenate(rows)[:count]


@pytest.mark.parametrize("inertia", [None, INERTIA, MATRIX])
def test_noise_is_that_of_the_generator(inertia):
    frame = fr.PhaseSpace(fr.Product(fr.Euclidean(3), fr.Euclidean(3)), (2.0, inertia))
    y0 = np.zeros((3, 12))
    solution = cg.solve_ensemble(
        lambda t, y: np.zeros(6), (1.0, 1.75), y0, frame=frame, thermostat=BATH, **STEPS,
        t_eval=[1.0, 1.25, 1.5, 1.75],
    )  # fmt: skip
    matrix = np.eye(3) if inertia is None else np.array(inertia)
    root = np.diag(np.sqrt(matrix)) if matrix.ndim == 1 else np.linalg.cholesky(matrix)
    kept = np.exp(-0.25)
    for member in range(3):
        momentum = np.zeros(6)
        for k in range(3):
            xi = variates(11, member, (4 + k) << 20, 6)
            noise = np.concatenate([np.sqrt(2.0) * xi[:3], root @ xi[3:]])
            momentum = kept * momentum + np.sqrt(0.7 * (1 - kept**2)) * noise
            assert np.allclose(solution.y[k + 1, member, 6:], momentum, rtol=0.0, atol=1e-14)


def test_streams_depend_on_nothing_else():
    top = system(fr.SO3(), INERTIA)
    y0 = np.stack([top.y0] * 5)
    options = {"frame": top.frame, "thermostat": BATH, **STEPS}
    solution = cg.solve_ensemble(top.f, (0, 4), y0, **options)
    end = solution.y[-1]
    assert len(np.unique(end[:, 0])) == 5
    parallel = cg.solve_ensemble(top.f, (0, 4), y0, workers=2, **options)
    vectorized = cg.solve_ensemble(top.f, (0, 4), y0, vectorized=True, **options)
    assert np.array_equal(parallel.y[-1], end)
    assert np.allclose(vectorized.y[-1], end, rtol=0.0, atol=2e-14)
    assert np.array_equal(cg.solve_ivp(top.f, (0, 4), top.y0, **options).y[-1], end[0])
    half = cg.solve_ensemble(top.f, (0, 1.5), y0, **options).y[-1]
    rest = cg.solve_ensemble(top.f, (1.5, 4), half, **options).y[-1]
    assert np.allclose(rest, end, rtol=0.0, atol=2e-14)
    stepper = cg.Stepper(top.f, 0.0, top.y0, **options)
    stepper.advance(1.5)
    for copy in (stepper, pickle.loads(pickle.dumps(stepper))):
        copy.advance(4.0)
        assert np.array_equal(copy.y, end[0])
    refuses(RuntimeError, "dense_output must not come", stepper.dense_output)
    other = cg.Langevin(1.0, 0.7, seed=12)
    assert not np.array_equal(
        cg.solve_ivp(top.f, (0, 4), top.y0, **options | {"thermostat": other}).y[-1], end[0]
    )
    assert pickle.loads(pickle.dumps(BATH)) == BATH
    assert cg.Langevin(1.0, 0.7) != cg.Langevin(1.0, 0.7)


@pytest.mark.parametrize("name", ["Leapfrog", "McLachlan2", "BlanesMoan4"])
def test_without_friction_nothing_changes(name):
    top = system(fr.Product(fr.SO3(), fr.Sphere(2), fr.UnitQuaternion()), (INERTIA, 2.0, MATRIX))
    plain = top.run(name, h=0.1)
    bath = top.run(name, h=0.1, thermostat=cg.Langevin(0.0, 3.0, seed=1))
    assert np.allclose(bath.y, plain.y, rtol=0.0, atol=1e-13)
    warm = top.run(name, h=0.1, thermostat=BATH)
    assert warm.nfev == plain.nfev
    assert np.abs(warm.y - plain.y).max() > 0.1
    assert top.frame.membership_error(warm.y).max() < 1e-14
    body = slice(9, 12), slice(-6, -3)
    assert np.abs(np.vecdot(warm.y[:, body[0]], warm.y[:, body[1]])).max() < 1e-14


def test_steps_end_at_output_times():
    frame = fr.PhaseSpace(fr.Euclidean(1))
    options = {"frame": frame, "thermostat": BATH, **STEPS}
    solution = cg.solve_ivp(spring, (0, 1), np.ones(2), t_eval=[0.0, 0.3, 1.0], **options)
    one = cg.solve_ivp(spring, (0, 0.3), np.ones(2), **options).y[-1]
    assert np.array_equal(solution.y[1], one)


@pytest.mark.parametrize(("method", "rod"), [("Leapfrog", False), ("RATTLE4", True)])
def test_equilibrium_above_a_floor(method, rod):
    """Heights are exponential, on a rod up to its length; crossings have <p²> = 2 T m."""
    joints = [fr.Joint("distance", (None, [0.0, 0, 0]), (0, [0.0, 0, 0]), length=1.0)] * rod
    frame = fr.PhaseSpace(fr.Euclidean(3), 0.5, joints=joints)

    def bounce(t, y):
        return np.concatenate([y[:5], [-y[5]]])

    rng = np.random.default_rng(4)
    angle, height = rng.uniform(0, 6, 300), rng.uniform(0, 1, 300)
    across = np.sqrt(1.0 - height**2)
    q = np.column_stack([across * np.cos(angle), across * np.sin(angle), height])
    solution = cg.solve_ensemble(
        lambda t, y: [0.0, 0.0, -1.0], (0, 24), frame.join(q, frame.random_momentum(q, 0.7, rng)),
        frame=frame, method=method, h=0.1, thermostat=BATH, t_eval=np.arange(6.0, 25.0),
        events=cg.Event(lambda t, y: y[2], direction=-1, jump=bounce),
    )  # fmt: skip
    heights = solution.y[..., 2].mean(axis=0)
    error = heights.std() / np.sqrt(300)
    mean = 0.7 - rod / np.expm1(1 / 0.7)
    assert solution.y[..., 2].min() > 0.0
    assert abs(heights.mean() - mean) < 4 * error < 0.12
    speed = np.concatenate([points[:, 5] for points in solution.y_events[0]])
    assert speed.max() < 0.0
    assert abs((speed**2).mean() - 0.7) < 0.07


@pytest.mark.parametrize("h", [1.0, 0.5])
def test_equilibrium_of_an_oscillator(h):
    """Of the leapfrog method <q²> = T / k is exact, and <p²> = T m (1 - h² k / 4m)."""
    frame = fr.PhaseSpace(fr.Euclidean(1))
    solution = cg.solve_ensemble(
        spring, (0, 100), np.zeros((4000, 2)), frame=frame, method="Leapfrog", h=h,
        vectorized=True, thermostat=BATH, t_eval=np.arange(20.0, 101.0, 4.0),
    )  # fmt: skip
    squares = (solution.y**2).mean(axis=0)
    error = squares.std(axis=0) / np.sqrt(4000)
    expected = 0.7 * np.array([1.0, 1.0 - h * h / 4])
    assert error.max() < 0.006
    assert (np.abs(squares.mean(axis=0) - expected) < 3.5 * error).all()


def test_equilibrium_of_a_dipole_in_a_field():
    frame, field = fr.PhaseSpace(fr.SO3(), INERTIA), 1.2

    def torque(t, y):
        return field * np.cross([0.0, 0.0, 1.0], frame.split(y)[0][..., 2, :])

    rng = np.random.default_rng(3)
    q = fr.SO3().random_point(rng, 1000)
    y0 = frame.join(q, frame.random_momentum(q, 0.7, rng))
    solution = cg.solve_ensemble(
        torque, (0, 40), y0, frame=frame, vectorized=True, thermostat=BATH,
        t_eval=np.arange(10.0, 41.0, 2.0), **STEPS,
    )  # fmt: skip
    kinetic = frame.kinetic_energy(solution.y).mean(axis=0)
    cosine = solution.y[:, :, 8].mean(axis=0)
    errors = np.array([each.std() / np.sqrt(1000) for each in (kinetic, cosine)])
    assert errors.max() < 0.01
    x = field / 0.7
    # the kinetic energy has an error of order two: -0.056 (h / 0.8)²
    expected = 1.05 - 0.056 * (0.25 / 0.8) ** 2, 1 / np.tanh(x) - 1 / x
    assert (np.abs([kinetic.mean(), cosine.mean()] - np.array(expected)) < 3.5 * errors).all()


def test_noise_opens_no_joints_and_has_the_same_streams():
    joints = [
        fr.Joint("ball", (None, [0, 0, 0]), (0, [0, 0, -0.5])),
        fr.Joint("hinge", (0, [0, 0, 0.5], [1, 0, 0]), (1, [0, 0, -0.5], [1, 0, 0])),
    ]
    body = fr.Product(fr.SO3(), fr.Euclidean(3))
    frame = fr.PhaseSpace(fr.Power(body, 2), (INERTIA, 1.0), joints=joints)
    q = np.array([[*np.eye(3).ravel(), 0, 0, 0.5], [*np.eye(3).ravel(), 0, 0, 1.5]])
    y0 = np.tile(frame.join(q, np.zeros(12)), (200, 1))
    options = {"frame": frame, "method": "RATTLE4", "h": 0.1, "thermostat": BATH}
    end = cg.solve_ensemble(unforced, (0, 4), y0, vectorized=True, **options).y[-1]
    assert frame.membership_error(end).max() < 1e-13
    # of 12 freedoms three and five are constrained
    kinetic = frame.kinetic_energy(end)
    assert abs(kinetic.mean() - 0.7 * 4 / 2) < 3.5 * 0.7 * np.sqrt(2.0 / 200)
    parallel = cg.solve_ensemble(unforced, (0, 4), y0[:3], workers=2, **options).y[-1]
    assert np.array_equal(parallel, end[:3])
    stepper = cg.Stepper(unforced, 0.0, y0[0], **options)
    stepper.advance(1.7)
    for copy in (stepper, pickle.loads(pickle.dumps(stepper))):
        copy.advance(4.0)
        assert np.array_equal(copy.y, end[0])


def test_random_momenta_are_those_of_the_temperature():
    frame = fr.PhaseSpace(
        fr.Product(fr.SO3(), fr.Sphere(2), fr.Euclidean(3)), (MATRIX, 2.0, INERTIA)
    )
    rng = np.random.default_rng(4)
    q = np.repeat(frame.configuration.random_point(rng)[None], 40000, axis=0)
    momentum = frame.random_momentum(q, 0.7, rng)
    point = q[0, 9:12]
    covariance = np.zeros((9, 9))
    covariance[:3, :3], covariance[6:, 6:] = MATRIX, np.diag(INERTIA)
    covariance[3:6, 3:6] = 2.0 * (np.eye(3) - np.outer(point, point))
    assert np.allclose(np.cov(momentum.T), 0.7 * covariance, rtol=0.0, atol=0.04)
    assert np.abs(momentum[:, 3:6] @ point).max() < 1e-14


@pytest.mark.parametrize(("changes", "message"), [
    ({"thermostat": 1.0}, "thermostat must be a cg.Langevin or None"),
    ({"method": "DOP853", "h": None}, "method must be a splitting method with a ther"),
    ({"method": cg.Splitting([0, "2/3", "1/3"], ["1/4", "3/4"])}, "method must be symmetric with"),
    ({"t_span": (1, 0)}, "thermostat must be None backward in time"),
    ({"dense_output": True}, "dense_output must be False"),
    ({"derivatives": "forward"}, "thermostat must be None with derivatives"),
])  # fmt: skip
def test_what_heat_baths_refuse(changes, message):
    top = system(fr.SO3(), INERTIA)
    options = {"t_span": (0, 1), "frame": top.frame, "thermostat": BATH, **STEPS, **changes}
    span = options.pop("t_span")
    error = TypeError if "must be a cg.Langevin" in message else ValueError
    refuses(error, message, cg.solve_ivp, top.f, span, top.y0, **options)
    if span == (1, 0):
        refuses(ValueError, message, cg.Stepper, top.f, 1.0, top.y0, 0.0, **options)


@pytest.mark.parametrize(("arguments", "message"), [
    ((-1.0, 1.0), "friction must be finite and not negative"),
    ((1.0, np.inf), "temperature must be finite"), (("1", 1.0), "friction must be a real"),
    ((1.0, 1.0, -1), "seed must be"), ((1.0, 1.0, 2**63), "seed must be"),
])  # fmt: skip
def test_what_langevin_refuses(arguments, message):
    error = TypeError if message.endswith("a real") else ValueError
    refuses(error, message, cg.Langevin, *arguments)
