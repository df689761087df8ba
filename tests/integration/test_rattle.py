"""Motion with joints: orders, structure, and every way to integrate."""

import numpy as np
import pytest
from mechanics import BODIES, GRAVITY, chain, closed_by_ball, double_pendulum, four_bar
from refusals import refuses
from scipy.integrate import solve_ivp
from slow_cases import slow

import cg
from cg.frames import SO3, Euclidean, Joint, PhaseSpace, Power, Product, Sphere

PENDULUM = double_pendulum()
METHODS = {"RATTLE": (2, 40), "RATTLE4": (4, 20), "RATTLE6": (6, 10), "RATTLE8": (8, 6)}
ADAPTIVE = {"rtol": 1e-11, "atol": 1e-11}


@pytest.fixture(scope="module")
def reference_end():
    return PENDULUM.run("RATTLE8", (0.0, 0.5), h=0.005).y[-1]


@pytest.mark.parametrize("method", METHODS)
def test_slopes_are_orders(method, reference_end):
    order, n = METHODS[method]
    runs = [PENDULUM.run(method, (0.0, 0.5), h=0.5 / k) for k in (n, 2 * n)]
    errors = [np.abs(run.y[-1] - reference_end).max() for run in runs]
    assert errors[1] > 1e-12
    assert abs(np.log2(errors[0] / errors[1]) - order) < (0.5 if order == 8 else 0.2)
    assert max(PENDULUM.frame.membership_error(run.y).max() for run in runs) < 1e-14


@pytest.mark.parametrize("method", ["auto", "RKMK5(4)", "DOP853", "CF5(4)", "RadauIIA5"])
def test_other_methods_keep_joints_closed(method, reference_end):
    options = {"rtol": 1e-8, "atol": 1e-8} if method == "RadauIIA5" else ADAPTIVE
    run = PENDULUM.run(method, (0.0, 0.5), t_eval=[0.0, 0.123, 0.377, 0.5], **options)
    assert np.abs(run.y[-1] - reference_end).max() < 10 * options["rtol"]
    assert PENDULUM.frame.membership_error(run.y).max() < 1e-14
    between = PENDULUM.run("RATTLE8", (0.0, 0.377), h=0.377 / 80).y[-1]
    assert np.abs(run.y[2] - between).max() < 10 * options["rtol"]


def test_output_between_steps_has_the_order_of_rattle():
    times = np.linspace(0.013, 0.487, 9)
    exact = PENDULUM.run("DOP853", (0.0, 0.5), t_eval=times, rtol=1e-13, atol=1e-13).y
    for method, n in (("RATTLE4", 20), ("RATTLE6", 12)):
        errors = []
        for k in (n, 2 * n):
            run = PENDULUM.run(method, (0.0, 0.5), h=0.5 / k, dense_output=True)
            assert PENDULUM.frame.membership_error(run.sol(times)).max() < 1e-13
            errors.append(np.abs(run.sol(times) - exact).max())
        assert abs(np.log2(errors[0] / errors[1]) - METHODS[method][0]) < 0.6


def test_a_hung_body_is_a_heavy_top():
    """In place of a joint, the inertia about the fixed point."""
    inertia, mass, arm = np.diag([0.3, 0.5, 0.6]), 1.7, np.array([0.1, -0.2, 0.5])
    about = inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    top = PhaseSpace(SO3(), about)
    weight = lambda q: np.cross(arm, -mass * GRAVITY * q[2])
    free = lambda t, y: weight(top.split(y)[0])
    body = Product(SO3(), Euclidean(3))
    hung = PhaseSpace(body, (inertia, mass), joints=[Joint("ball", (None, np.zeros(3)), (0, -arm))])
    turn, w = SO3().flow([0.5, 0.3, -0.2], np.eye(3)), np.array([1.0, 2.0, 3.0])
    momentum = [*inertia @ w, *mass * turn @ np.cross(w, arm)]
    y0 = hung.join(body.join(turn, turn @ arm), momentum)
    options = {"rtol": 1e-12, "atol": 1e-12}
    one = cg.solve_ivp(free, (0, 2), top.join(turn, about @ w), frame=top, **options).y[-1]
    force = np.array([0, 0, 0, 0, 0, -mass * GRAVITY])
    for choice in (options, {"method": "RATTLE8", "h": 0.02}):
        run = cg.solve_ivp(lambda t, y: force, (0, 2), y0, frame=hung, **choice)
        assert np.abs(run.y[-1][:9] - one[:9]).max() < 1e-11
        assert np.abs(hung.velocity(run.y[-1])[:3] - top.velocity(one)).max() < 3e-11


def test_steps_can_be_undone():
    forth = PENDULUM.run("RATTLE6", (0.0, 1.0), h=0.02).y[-1]
    back = PENDULUM.run("RATTLE6", (1.0, 0.0), y0=forth, h=0.02).y[-1]
    assert np.abs(forth - PENDULUM.y0).max() > 0.1
    assert np.abs(back - PENDULUM.y0).max() < 1e-13


@pytest.mark.parametrize("start", ["at rest", "moving"])
def test_small_momenta_open_no_joint_in_any_unit(start):
    length, mass, time = 1e-9, 1e-26, 1e-12  # of molecules, where a second is long
    ends = [[0, 0, -0.5 * length], [0, 0, 0.5 * length]]
    joints = [
        Joint("hinge", (None, [0, 0, 0], [0, 1, 0]), (0, ends[1], [0, 1, 0])),
        Joint("distance", (0, ends[0]), (1, ends[1]), length=length),
    ]
    inertia = mass * length**2 * np.array([0.2, 0.3, 0.4]), mass
    frame = PhaseSpace(Power(Product(SO3(), Euclidean(3)), 2), inertia, joints=joints)
    q = [[*np.eye(3).ravel(), 0, 0, height * length] for height in (-0.5, -2.5)]
    momentum = mass * length / time * np.array([0, 0.3 * length, 0, 0, 0, 0] * 2)
    y0 = frame.join(q, momentum * (start == "moving"))
    weight = [0, 0, 0, 0, 0, -9.81 * mass * length / time**2] * 2
    options = {"frame": frame, "method": "RATTLE4", "h": 0.01 * time}
    run = cg.solve_ivp(lambda t, y: weight, (0, 3 * time), y0, **options)
    back = cg.solve_ivp(lambda t, y: weight, (3 * time, 0), run.y[-1], **options)
    assert max(frame.relative_error(each.y).max() for each in (run, back)) < 1e-13


def test_steps_are_symplectic():
    """The symplectic form of tangents of the constrained phase space, by differences."""
    frame, h = PENDULUM.frame, 0.1
    rng = np.random.default_rng(2)

    def form(y, u, v):
        bracket = frame.configuration.bracket(u[:12], v[:12])
        return u[:12] @ v[12:] - v[:12] @ u[12:] - y[-12:] @ bracket

    def moved(direction, step):
        q, momentum = frame.split(frame.flow(step * direction, PENDULUM.y0))
        start = frame.join(q, momentum)
        end = PENDULUM.run("RATTLE4", (0.0, h), y0=start, h=h).y[-1]
        return start, end

    def tangents(direction):
        pairs = zip(moved(direction, 1e-5), moved(direction, -1e-5), strict=True)
        return [frame.exp_coordinates(behind, ahead) / 2e-5 for ahead, behind in pairs]

    ends = PENDULUM.y0, PENDULUM.run("RATTLE4", (0.0, h), h=h).y[-1]
    (u, after_u), (v, after_v) = (tangents(rng.standard_normal(24)) for _ in range(2))
    assert abs(form(ends[0], u, v)) > 0.1
    assert np.abs(after_u - u).max() > 0.1
    assert abs(form(ends[0], u, v) - form(ends[1], after_u, after_v)) < 1e-7


def test_a_spatial_pendulum_of_rods_is_that_in_cartesian_coordinates():
    """N point masses on rods, as in arXiv 2109.12325, whose reference has Lagrange multipliers."""
    lengths, masses = np.array([0.8, 1.1, 0.5, 0.9]), np.array([1.0, 0.6, 1.7, 0.4])
    n, origin = len(masses), [0.0, 0.0, 0.0]
    joints = [
        Joint("distance", (k - 1 if k else None, origin), (k, origin), length=length)
        for k, length in enumerate(lengths)
    ]
    frame = PhaseSpace(Power(Euclidean(3), n), np.tile(masses[:, None], (1, 3)), joints=joints)
    weight = np.zeros((n, 3))
    weight[:, 2] = -GRAVITY * masses
    random = np.random.default_rng(8)
    rods = Sphere(2).random_point(random, n)
    velocities = np.cumsum(np.cross(rods, random.standard_normal((n, 3))) * lengths[:, None], 0)
    y0 = frame.join(
        np.cumsum(lengths[:, None] * rods, axis=0), (masses[:, None] * velocities).ravel()
    )

    def reference(t, z):
        x, v = z.reshape(2, n, 3)
        rods, rates = (np.diff(w, axis=0, prepend=np.zeros((1, 3))) for w in (x, v))
        rows = np.zeros((n, n, 3))
        for k in range(n):
            rows[k, k] = rods[k]
            if k:
                rows[k, k - 1] = -rods[k]
        rows = rows.reshape(n, 3 * n)
        inverse = np.repeat(1 / masses, 3)
        right = -rows @ (inverse * weight.ravel()) - (rates**2).sum(axis=1)
        multipliers = np.linalg.solve(rows * inverse @ rows.T, right)
        return np.concatenate([v.ravel(), inverse * (weight.ravel() + multipliers @ rows)])

    start = np.concatenate([y0[: 3 * n], y0[3 * n :] / np.repeat(masses, 3)])
    exact = solve_ivp(reference, (0, 1), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    f = lambda t, y: weight.ravel()
    for options in ({"method": "RATTLE8", "h": 0.01}, {"rtol": 1e-10, "atol": 1e-10}):
        end = cg.solve_ivp(f, (0, 1), y0, frame=frame, **options).y[-1]
        np.testing.assert_allclose(end[: 3 * n], exact[: 3 * n], rtol=0, atol=1e-8)
        assert frame.membership_error(end) < 1e-13


@pytest.mark.parametrize(("method", "end", "largest", "drift"), [
    ("RATTLE4", 400.0, 5e-5, 5e-7), *slow(("RATTLE", 90000.0, 0.02, 3e-4))
])  # fmt: skip
def test_energy_stays_for_long_times(method, end, largest, drift):
    """For more swings than seconds; how many in a long time depends on rounding (chaos)."""
    times = np.linspace(0.0, end, int(10 * end) + 1)
    run = PENDULUM.run(method, (0.0, end), h=0.02, t_eval=times)
    height = run.y[:, PENDULUM.heights[0]]
    assert (np.diff(np.sign(np.diff(height))) < 0).sum() > (1.1 * end if end < 1000 else end)
    energy, tenth = PENDULUM.energy(run.y) - PENDULUM.energy(PENDULUM.y0), int(end)
    assert np.abs(energy).max() < largest
    assert abs(energy[-tenth:].mean() - energy[:tenth].mean()) < drift
    assert PENDULUM.frame.membership_error(run.y).max() < 1e-13


def test_a_four_bar_linkage_turns():
    frame, q = four_bar(closed_by_ball)
    y0 = frame.join(q, np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 3))
    f = lambda t, y: np.zeros(18)
    run = cg.solve_ivp(f, (0.0, 5.0), y0, frame=frame, method="RATTLE4", h=0.02)
    other = cg.solve_ivp(f, (0.0, 5.0), y0, frame=frame, rtol=1e-11, atol=1e-11)
    assert np.abs(run.y[-1] - other.y[-1]).max() < 5e-8
    assert frame.membership_error(run.y).max() < 1e-13
    kinetic = frame.kinetic_energy(run.y)
    assert np.ptp(kinetic) < 3e-8 * kinetic[0]


@pytest.mark.parametrize("kind", ["ball", "hinge"])
def test_a_chain_of_two_hundred_bodies(kind):
    problem = chain(200, kind)
    run = problem.run("RATTLE", (0.0, 0.05), h=0.005)
    assert problem.frame.membership_error(run.y).max() < 1e-12
    assert abs(problem.energy(run.y[-1]) - problem.energy(problem.y0)) < 5e-7 * GRAVITY * 200
    assert run.y[-1][11::12][:200].min() < -1e-3  # it falls


@pytest.mark.parametrize(("length", "offset"), [(1e-9, 0.0), (1.0, 0.0), (1e9, 0.0), (1e-3, 1e4)])
def test_differences_of_constraints_at_any_scale(length, offset):
    """A rod of any length about a point far away, with time in units of its swings."""
    top, space = np.array([offset * length, 0.0, 0.0]), Euclidean(3)
    g = lambda q: [np.linalg.norm(q - top) - length]
    slopes = lambda q: [(q - top) / np.linalg.norm(q - top)]
    rod = Joint("distance", (None, [0.0, 0.0, 0.0]), (0, [0.0, 0.0, 0.0]), length=length)
    unit, ends = np.sqrt(length * GRAVITY), []
    for given, shift in (
        ({"joints": [rod]}, 0.0), ({"constraints": (g, slopes)}, top), ({"constraints": g}, top)
    ):  # fmt: skip
        frame = PhaseSpace(space, 1.0, **given)
        start = length * np.array([np.sin(1.0), 0.0, -np.cos(1.0)])
        y0 = frame.join(start + shift, [0.0, 0.3 * unit, 0.0])
        problem = lambda t, y: [0.0, 0.0, -GRAVITY], (0, 3 * unit / GRAVITY), y0
        run = cg.solve_ivp(*problem, frame=frame, rtol=1e-8, atol=1e-8 * length)
        assert run.nfev < (400 if length > 1e-6 else 700)
        ends.append((run.y[-1, :3] - shift) / length)
        run = cg.solve_ivp(*problem, frame=frame, method="RATTLE4", h=0.03 * unit / GRAVITY)
        ends.append((run.y[-1, :3] - shift) / length)
    for other in (ends[2:4], ends[4:]):
        np.testing.assert_allclose(other, ends[:2], rtol=0, atol=1e-6 if offset else 2e-8)


def test_constraints_in_python():
    g = lambda q: BODIES.split(q)[1] + BODIES.split(q)[0] @ [0.1, 0.2, 0.9]
    second = PENDULUM.frame.joints[1:]
    own = double_pendulum(second, constraints=g)
    for options in (
        {"method": "RATTLE4", "h": 0.02},
        {"rtol": 1e-9, "atol": 1e-9, "method": "auto"},
    ):
        runs = [x.run(span=(0.0, 0.2), **options).y[-1] for x in (PENDULUM, own)]
        assert np.abs(runs[0] - runs[1]).max() < 5e-11
        assert own.frame.membership_error(runs[1]) < 1e-13
    calls = []

    def failing(q):
        calls.append(q)
        if len(calls) > 500:
            raise KeyError("lost")
        return g(q)

    broken = double_pendulum(second, constraints=failing)
    refuses(KeyError, "lost", broken.run, "RATTLE", (0.0, 5.0), h=0.01)
    edge = PhaseSpace(Euclidean(2), constraints=lambda q: [q[1] if q[0] < 1 else np.nan])
    for force, reason in ((0.0, "no forces that keep joints closed"), (np.inf, "f must return")):
        push = lambda t, y, force=force: [force if y[0] > 0.9 else 0.0, 0.0]
        run = cg.solve_ivp(push, (0, 2), [0.0, 0.0, 1.0, 0.0], frame=edge)
        assert reason in run.message
        assert "however small the step" in run.message
    more = PhaseSpace(Euclidean(2), constraints=lambda q: [q[1]] * (1 + (q[0] > 1)))
    for options in ({}, {"method": "RATTLE", "h": 0.1}):
        with pytest.raises(ValueError, match=r"must return shape \(1,\), got \(2,\)"):
            cg.solve_ivp(
                lambda t, y: [0.0, 0.0], (0, 2), [0.0, 0.0, 1.0, 0.0], frame=more, **options
            )


def test_a_stepper_goes_on_after_constraints_have_failed():
    broken = []
    g = lambda q: [1 / 0 if broken else q @ q - 1]
    sphere = PhaseSpace(Euclidean(3), constraints=g)
    points = [sphere.join([0.6, 0.0, 0.8], [0, 0.5, 0]), sphere.join([0.0, 0.6, 0.8], [0.5, 0, 0])]
    fall = lambda t, y: [0.0, 0.0, -1.0]
    steppers = [cg.Stepper(fall, 0.0, y, frame=sphere, method="RATTLE", h=0.05) for y in points]
    steppers[0].step()
    steppers[0].restart(y=points[1], t=0.0)
    broken.append(True)
    refuses(ZeroDivisionError, "division", steppers[0].step)
    broken.clear()
    steppers[0].restart(y=points[1], t=0.0)
    for stepper in steppers:
        stepper.advance(0.3)
    np.testing.assert_array_equal(steppers[0].y, steppers[1].y)


def forces(t, y):
    return PENDULUM.forces


BOUNCE = [
    cg.Event(lambda t, y: y[PENDULUM.heights[1]] + 2.25, jump=lambda t, y: [*y[:24], *-y[24:]])
]


@pytest.mark.parametrize("events", [[], BOUNCE], ids=["smooth", "jump"])
def test_derivatives_of_solutions(events):
    options = {"rtol": 1e-10, "atol": 1e-10, "events": events or None}
    run = cg.solve_variational(PENDULUM.f, (0.0, 0.3), PENDULUM.y0, frame=PENDULUM.frame, **options)
    frame, end = PENDULUM.frame, run.y[-1]
    assert frame.membership_error(run.y).max() < 2e-14
    rng = np.random.default_rng(4)
    q, momentum = frame.split(frame.flow(1e-5 * rng.standard_normal(24), PENDULUM.y0))
    near = frame.join(q, momentum)
    moved = PENDULUM.run("auto", (0.0, 0.3), y0=near, **options).y[-1]
    expected = run.transition[-1] @ frame.exp_coordinates(PENDULUM.y0, near)
    assert np.abs(frame.exp_coordinates(end, moved) - expected).max() < 3e-9
    assert not events or len(run.t_events[0])


def test_separate_kicks_and_drifts_are_refused():
    message = "method must be 'RATTLE' or a composition"
    for method in ("BlanesMoan4", "McLachlan2"):
        refuses(ValueError, message, PENDULUM.run, method, (0.0, 1.0), h=0.1)
    same = [PENDULUM.run(method, (0.0, 0.1), h=0.01).y[-1] for method in ("RATTLE", "Leapfrog")]
    assert np.array_equal(*same)


def test_steps_that_are_too_long_fail():
    refuses(ArithmeticError, "the step is too long", PENDULUM.run, "RATTLE", (0.0, 9.0), h=1.5)


def test_starts_with_redundant_constraints_are_refused():
    rod = Joint("distance", (0, [0, 0, 0]), (1, [0, 0, 0]), length=1.0)
    space = Power(Euclidean(3), 2)
    frame = PhaseSpace(space, joints=[rod, rod])
    y0 = np.zeros(12)
    y0[3] = 1.0
    message = "rank 1 of 2 at y0"
    refuses(ValueError, message, cg.solve_ivp, lambda t, y: np.zeros(6), (0, 1), y0, frame=frame)


@pytest.mark.parametrize("method", ["RATTLE", "RATTLE4", "DOP853"])
def test_free_bodies_may_move_by_many_lengths_in_a_step(method):
    joint = Joint("ball", (0, [0, 0, 0.05]), (1, [0, 0, -0.05]))
    frame = PhaseSpace(BODIES, joints=[joint])
    at = np.array([[*np.eye(3).ravel(), 0, 0, z] for z in (-0.05, 0.05)])
    y0 = frame.join(at.ravel(), np.tile([0.0, 0.0, 0.0, 1e4, 0.0, 0.0], 2))
    options = {} if method == "DOP853" else {"h": 0.1}
    run = cg.solve_ivp(lambda t, y: np.zeros(12), (0, 1), y0, frame=frame, method=method, **options)
    places = frame.split(run.y[-1])[0].reshape(2, 12)[:, 9:]
    np.testing.assert_allclose(places, [[1e4, 0, -0.05], [1e4, 0, 0.05]], rtol=0, atol=2e-10)
