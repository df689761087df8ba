"""Splitting methods on phase spaces: orders, structure, and every way to integrate."""

import ctypes

import numpy as np
import pytest
from interpolants import extra_evaluations
from mechanics import INERTIA, MATRIX, SPLITTINGS, system
from quotients import jacobian
from refusals import refuses
from scipy import LowLevelCallable

import cg
from cg.frames import SO3, SU, Euclidean, PhaseSpace, Power, Product, Sphere, UnitQuaternion

pytestmark = pytest.mark.sanitize

TOP = system(SO3(), INERTIA)
LATTICE = system(SU(3))
SPACE_AXES = system(SO3("space"), 2.0)
BODIES = system(Power(Product(Euclidean(3), UnitQuaternion()), 3), (MATRIX, INERTIA))
DRIFT_FIRST = [name for name in SPLITTINGS if cg.methods[name].drifts[0]]


def error(run, reference):
    return np.abs(run.y[-1] - reference.y[-1]).max()


@pytest.mark.parametrize("method", SPLITTINGS)
@pytest.mark.parametrize("problem", [TOP, LATTICE], ids=["heavy top", "SU(3)"])
def test_slopes_are_orders(problem, method):
    order = cg.methods[method].order
    coarse, span = {2: 40, 4: 20, 6: 8, 8: 4}[order], (0.0, 2.0)
    coarse += 3 * (method == "RATTLE8")  # its errors decrease faster at first
    exact = problem.reference(span)
    errors = [error(problem.run(method, span, h=span[1] / n), exact) for n in (coarse, 2 * coarse)]
    assert errors[1] > 1e-13  # more than rounding
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.2


def poisson(frame, y):
    """Return the Poisson brackets of the coordinates of the frame's fields at a point."""
    n = frame.configuration.dim
    brackets = frame.configuration.bracket(np.eye(n)[:, None], np.eye(n))
    matrix = np.zeros((2 * n, 2 * n))
    matrix[:n, n:], matrix[n:, :n] = np.eye(n), -np.eye(n)
    matrix[n:, n:] = brackets @ y[-n:]
    return matrix


def defect(problem, method, h):
    """Return by how much one step changes the Poisson brackets, by differences."""
    frame = problem.frame
    step = lambda v: problem.run(method, (0.0, h), y0=frame.flow(v, problem.y0), h=h).y[-1]
    after = step(np.zeros(frame.dim))
    derivative = jacobian(lambda v: frame.exp_coordinates(after, step(v)), frame.dim, bound=1e-11)
    assert np.abs(derivative - np.eye(frame.dim)).max() > 0.1
    moved = derivative @ poisson(frame, problem.y0) @ derivative.T
    return np.abs(moved - poisson(frame, after)).max()


@pytest.mark.parametrize(("problem", "method"), [
    *((TOP, method) for method in SPLITTINGS), (LATTICE, "BlanesMoan6"), (SPACE_AXES, "RATTLE6"),
    (BODIES, "McLachlan2"),
], ids=str)  # fmt: skip
def test_steps_are_symplectic(problem, method):
    assert defect(problem, method, 0.2) < 3e-11


def test_steps_of_ordinary_methods_are_not():
    assert defect(TOP, "CG3", 0.5) > 1e-4


def test_the_energy_error_does_not_grow(compiled_function):
    """Of a top, with its force in C."""
    numbers = np.array([0.2, -0.1, 1.0])
    force = LowLevelCallable(compiled_function("heavy"), numbers.ctypes.data_as(ctypes.c_void_p))
    problem = system(SO3(), INERTIA)
    problem.weights = np.outer([0.0, 0.0, 1.0], numbers)
    times = np.linspace(0.0, 20_000.0, 2001)
    y0 = problem.frame.join(SO3().flow([0.4, 0.3, 0.0], np.eye(3)), [0.5, 0.1, 2.0])
    common = {"frame": problem.frame, "t_eval": times}
    ours = cg.solve_ivp(force, (0.0, times[-1]), y0, method="BlanesMoan6", h=0.4, **common)
    usual = cg.solve_ivp(force, (0.0, times[-1]), y0, rtol=1e-8, atol=1e-8, **common)
    errors = [np.abs(problem.energy(run.y) - problem.energy(y0)) for run in (ours, usual)]
    assert ours.nfev <= usual.nfev
    assert errors[0].max() <= errors[1].max() / 200
    assert errors[0][-200:].max() <= 3 * errors[0][:200].max()


def test_one_force_for_each_kick():
    for method in SPLITTINGS:
        kicks, again = cg.methods[method].stages, method not in DRIFT_FIRST
        run = TOP.run(method, h=0.1)
        assert run.nfev == 10 * (kicks - again) + again
        halfway = TOP.run(method, h=0.1, t_eval=[0.55, 1.0])
        within = extra_evaluations(cg.methods[method])
        assert halfway.nfev == run.nfev + within + (0 if again else 2)


def test_a_force_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"shape \(3,\), got shape \(6,\)"):
        cg.solve_ivp(lambda t, y: np.zeros(6), (0, 1), TOP.y0, frame=TOP.frame)


@pytest.mark.parametrize(("change", "message"), [
    ({"h": None, "rtol": 1e-6}, "h must be given with .*, since steps of splitting"),
    ({"frame": Product(SO3(), Euclidean(3))}, "frame must be a cg.frames.PhaseSpace"),
    ({"f": lambda t, y: -y[-3:]}, "f must not depend on the momentum"),
    ({"f": lambda t, y: -t * y[-3:]}, "f must not depend on the momentum"),
])  # fmt: skip
def test_what_splitting_methods_refuse(change, message):
    options = {"f": TOP.f, "frame": TOP.frame, "method": "Leapfrog", "h": 0.1} | change
    f = options.pop("f")
    refuses(ValueError, message, cg.solve_ivp, f, (0, 1), TOP.y0, **options)


def drag(t, y, strength=1.0):
    """A force on two coordinates with friction where the first is near to one."""
    return -y[..., :2] - np.where(abs(y[..., :1] - 1.0) < 0.3, np.ravel(strength), 0.0) * y[..., 2:]


PLANE = {"frame": PhaseSpace(Euclidean(2)), "method": "BlanesMoan4", "h": 0.05}
STILL = np.array([0.0, 0.0, 1.0, 0.5])  # which comes to the region later, and leaves it


def test_friction_is_seen_in_a_region_and_by_a_stepper():
    refused = pytest.raises(ValueError, match="f must not depend on the momentum")
    outputs = {}, {"t_eval": np.linspace(0, np.pi, 40)}
    for options in (*outputs, *({"derivatives": "forward", **output} for output in outputs)):
        with refused:
            cg.solve_ivp(drag, (0, np.pi), STILL, **PLANE, **options)
    stepper = cg.Stepper(drag, 0.0, STILL, **PLANE)
    with refused:
        for _ in range(64):
            stepper.step()


@pytest.mark.parametrize("vectorized", [False, True])
def test_friction_is_seen_in_any_member(vectorized):
    refused = pytest.raises(ValueError, match=r"f must not depend on the momentum.* in member 2")
    f = (lambda t, y, p: -y[:, :2] - p * y[:, 2:]) if vectorized else drag
    start = np.stack([STILL + np.eye(4)[0]] * 3)
    numbers, free = np.array([[0.0], [0.0], [0.5]]), np.zeros((3, 1))
    options = PLANE | {"vectorized": vectorized}
    with refused:
        cg.solve_ensemble(f, (0, 1), start, parameters=numbers, **options)
    assert cg.solve_ensemble(f, (0, 1), start, parameters=free, **options).success
    stepper = cg.Stepper(f, 0.0, start, parameters=free, **options)
    with refused:
        stepper.restart(parameters=numbers)
    stepper.advance(1.0)
    inputs = cg.Samples([0, 1], np.stack([numbers, numbers], axis=1), members=True)
    pushed = lambda t, y, u: f(t, y, u)  # noqa: PLW0108 - f may name its arguments otherwise
    with refused:
        cg.solve_ensemble(pushed, (0, 1), start, inputs=inputs, **options)


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
def test_slopes_with_forces_of_the_velocity_are_orders(name):
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
def test_matrices_that_are_refused(frame, matrix, message):
    refuses(ValueError, message, PhaseSpace, frame, None, gyroscopic=matrix)


def test_derivatives_by_splitting_are_refused():
    top = gyroscopic(SO3(), INERTIA, ROTOR)
    options = {"h": 0.1, "derivatives": "forward"}
    refuses(ValueError, "gyroscopic", top.run, "Leapfrog", **options)
    assert top.run("CF5(4)", **options).transition.shape[1:] == (6, 6)
