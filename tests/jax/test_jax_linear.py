"""Linear equations and noise in JAX: steps, gradients, orders, laws, refusals."""

import numpy as np
import pytest
from jax_setup import diffrax, jax
from refusals import refuses
from slow_cases import slow

import cg
from cg.construction.methods.estimate import result_and_estimate
from cg.construction.methods.paths import paths_of
from cg.frames import SE3, SO3, SU, LinearAction, Sphere, UnitQuaternion
from cg.support.shared_numbers import STEP_CONTROL
from cg.tables import table_of

jnp = jax.numpy
pytestmark = pytest.mark.filterwarnings("ignore:Complex dtype support in Diffrax")

CHAIN = LinearAction([-1j * np.diag([1.0, 0, -1]), -1j * (np.eye(3, k=1) + np.eye(3, k=-1))])
STARTS = {SU(2): np.eye(2) + 0j, UnitQuaternion(): np.eye(4)[3], CHAIN: np.eye(3)[0] + 0j}


def drive(dim):
    return lambda t, xp: xp.stack([xp.cos((k + 1) * t) + 0.2 * k for k in range(dim)])


def check_steps(frame, name, y0, a, t1, tol):
    """Compare steps and the end with those of compiled code; return the end."""
    linear = name.startswith("CFM")
    term = cg.jax.LinearTerm if linear else cg.jax.FrameTerm
    here = diffrax.diffeqsolve(
        term(lambda t, *rest: a(t, jnp), frame), cg.jax.Solver(name), 0.0, t1, None,
        jnp.asarray(y0), 1.0, stepsize_controller=cg.jax.controller(frame, tol, tol),
    )  # fmt: skip
    there = cg.solve_ivp(
        lambda t, *y: a(t, np), (0, t1), y0, frame=frame, method=name, linear=linear, rtol=tol,
        atol=tol,
    )  # fmt: skip
    assert int(here.stats["num_steps"]) == there.steps + there.nrejected
    np.testing.assert_allclose(here.ys[-1], there.y[-1], rtol=0, atol=2e-14)
    return here.ys[-1]


@pytest.mark.parametrize(("frame", "name"), [
    (SU(2), "CFM8(4)"), (UnitQuaternion(), "CFM6(4)b"), *slow((SU(2), "CFM6(4)"))
], ids=repr)  # fmt: skip
def test_steps_are_those_of_compiled_code(frame, name):
    check_steps(frame, name, STARTS[frame], drive(frame.dim), 2.0, 1e-7)


@pytest.mark.parametrize("name", ["CFM8(4)", "RKMK8(5,3)"])
def test_estimates_in_parts_are_those_of_compiled_code(name):
    """Along a polynomial that hardly turns its axis quadratures and commutators differ most."""

    def a(t, xp):
        size = 4.0 * (t - 0.6) * (t - 1.3) * (t - 2.2)
        return size * xp.array([0.8, -0.05, -1.4]) + t * xp.array([0.1, 0.3, 0.05])

    check_steps(UnitQuaternion(), name, np.eye(4)[3], a, 2.5, 1e-10)


@pytest.mark.parametrize(("name", "power"), [
    ("CF5(4)", 4), ("CG5(4)", 4), ("DOP853", 2), ("DOP853", 5), ("Magnus8(4)", 2),
    ("RKMK8(5,3)", 6),
])  # fmt: skip
def test_estimates_of_a_step_are_the_same_in_all_places(name, power):
    """In compiled code, in JAX, and in the model of small changes, for each `EstimateForm`."""
    method, frame = cg.methods[name], UnitQuaternion()
    linear = isinstance(method, cg.MagnusMethod)
    angle, size, y0 = 1.5, 1e-6, np.eye(4)[3]
    values = paths_of(method).abscissae ** power
    estimate = result_and_estimate(method, values, np.array([angle]))[1].item()
    options = {"rtol": 3e-14, "atol": 10.0 * size * estimate / np.sqrt(3.0)}

    def a(t, xp):
        return xp.stack([size * xp.minimum(t, 1.0) ** power, 0.0 * t, angle + 0.0 * t])

    there = cg.solve_ivp(
        lambda t, *y: a(t, np), (0, 9), y0, frame=frame, method=name, linear=linear,
        first_step=1.0, breakpoints=[1.0], **options,
    )  # fmt: skip
    factor = np.diff(there.t)[1] / STEP_CONTROL["safety"]
    compiled = factor ** (-1.0 / (STEP_CONTROL["last_power"] * table_of(name).exponent))
    term = (cg.jax.LinearTerm if linear else cg.jax.FrameTerm)(lambda t, *rest: a(t, jnp), frame)
    solver, times, start = cg.jax.Solver(name), jnp.array([0.0, 1.0]), jnp.asarray(y0)
    state = solver.init(term, *times, start, None)
    end, error, *_ = solver.step(term, *times, start, None, state, False)
    in_jax = cg.jax.controller(frame, **options)._error_norm(start, end, error)
    np.testing.assert_allclose([compiled, in_jax], 0.1, rtol=1e-3)


def test_first_steps_resolve_fast_coefficients():
    frame, y0, tol = UnitQuaternion(), np.eye(4)[3], 1e-4
    a = lambda t, xp: 0.1 * xp.cos(84.5 * t + 6.0) * xp.array([1.0, 0.5, -0.5])
    end = check_steps(frame, "CFM8(4)", y0, a, 1.0, tol)
    turned = 0.1 * (np.sin(90.5) - np.sin(6.0)) / 84.5 * np.array([1.0, 0.5, -0.5])
    assert np.abs(end - frame.flow(turned, y0)).max() < tol / 1000


@pytest.mark.parametrize(("frame", "name", "bound"), [
    (SU(2), "CFM8(4)", 1e-10), (CHAIN, "CFM6(4)", 1e-8), *slow((SU(2), "CFM4", 1e-6))
], ids=repr)  # fmt: skip
def test_output_between_steps(frame, name, bound):
    """Also on a LinearAction, whose generators are dense in JAX."""
    times, y0, a = jnp.linspace(0.1, 1.9, 7), STARTS[frame], drive(frame.dim)
    here = diffrax.diffeqsolve(
        cg.jax.LinearTerm(lambda t, args: a(t, jnp), frame), cg.jax.Solver(name), 0.0, 2.0, 0.05,
        jnp.asarray(y0), saveat=diffrax.SaveAt(ts=times),
    )  # fmt: skip
    there = cg.solve_linear(
        lambda t: a(t, np), (0, 2), y0, frame=frame, rtol=1e-12, atol=1e-12,
        t_eval=np.asarray(times),
    )  # fmt: skip
    np.testing.assert_allclose(here.ys, there.y, rtol=0, atol=bound)


def test_jumps_begin_anew():
    a = lambda t, args: jnp.where(t < 1.0, 1.0, -3.0) * jnp.array([0.0, 0.3, 1.0])
    frame = SO3()
    controller = diffrax.ClipStepSizeController(
        cg.jax.controller(frame, 1e-8, 1e-8), jump_ts=jnp.array([1.0])
    )
    solution = diffrax.diffeqsolve(
        cg.jax.LinearTerm(a, frame), cg.jax.Solver("CFM6(4)"), 0.0, 2.0, None, jnp.eye(3),
        stepsize_controller=controller,
    )  # fmt: skip
    expected = frame.flow([0.0, -0.6, -2.0], np.eye(3))
    np.testing.assert_allclose(solution.ys[-1], expected, rtol=0, atol=1e-14)
    assert int(solution.stats["num_steps"]) < 12


def test_terms_of_points_are_refused():
    term = cg.jax.FrameTerm(lambda t, y, args: y[0], SO3())
    with pytest.raises(ValueError, match="LinearTerm"):
        diffrax.diffeqsolve(term, cg.jax.Solver("CFM4"), 0.0, 1.0, 0.1, jnp.eye(3))
    refuses(TypeError, "a must", cg.jax.LinearTerm, 3, SO3())


POINTS = {SO3(): np.eye(3), Sphere(2): np.eye(3)[2], SE3(): np.eye(4)}


def single(t, y, args):
    return jnp.stack([y[0, 0], 0.5, y[1, 2]])[:, None]


def isotropic(t, y, args):
    return args * jnp.eye(3)


def path_of(key, h, g, noises, frame=None, *, name="CF4", args=1.0, drift=None, **options):
    """Take steps of a size, or with None let an error estimate choose them."""
    frame = frame or SO3()
    path = diffrax.VirtualBrownianTree(0.0, 1.0, tol=2.0**-10, shape=(noises,), key=key)
    drift = drift or (lambda t, y, args: jnp.linspace(0.1, 0.5, frame.dim))
    terms = diffrax.MultiTerm(cg.jax.FrameTerm(drift, frame), cg.jax.NoiseTerm(g, path, frame))
    solver = cg.jax.Solver(name)
    y0 = POINTS[frame]
    if h is None:
        options["stepsize_controller"] = cg.jax.controller(frame, 1e-3, 1e-3)
    return diffrax.diffeqsolve(terms, solver, 0.0, 1.0, h, y0, args, **options).ys[-1]


def batch(number, *arguments, **options):
    """Return a function of the number of steps, which gives the ends of many paths."""
    keys = jax.random.split(jax.random.key(1), number)
    paths = jax.jit(
        jax.vmap(lambda key, h: path_of(key, h, *arguments, **options), in_axes=(0, None))
    )
    return lambda steps: paths(keys, 1.0 / steps)


@pytest.mark.parametrize(("g", "noises", "order"), [
    (single, 1, 1.0), *slow((isotropic, 3, 0.5))
])  # fmt: skip
def test_strong_orders(g, noises, order):
    ends, errors = batch(200, g, noises), []
    for steps in (4, 32):
        errors.append(jnp.sqrt(((ends(steps) - ends(256)) ** 2).sum((1, 2)).mean()))
    assert float(jnp.log2(errors[0] / errors[1])) / 3 == pytest.approx(order, abs=0.15)


def test_rotational_diffusion_has_its_law():
    """The mean of a representation of weight l decays as exp(-l (l + 1) σ² t / 2)."""
    rate, number = 0.6, 4000
    y = batch(number, isotropic, 3, args=rate, drift=lambda t, y, args: jnp.zeros(3))(8)
    first = np.asarray(y[:, 2, 2])
    second = 1.5 * first**2 - 0.5
    for sample, weight in ((first, 1), (second, 2)):
        expected = np.exp(-weight * (weight + 1) * rate**2 / 2)
        assert abs(sample.mean() - expected) < 4 * sample.std() / number**0.5 + 0.01


@pytest.mark.parametrize("frame", [Sphere(2), SE3()], ids=repr)
def test_points_stay_on_the_manifold(frame):
    g = lambda t, y, args: jnp.stack([jnp.ones(frame.dim), y.reshape(-1)[: frame.dim]], axis=1)
    y = batch(3, g, 2, frame)(16)
    assert np.asarray(frame.membership_error(np.asarray(y))).max() < 1e-14


def test_output_between_steps_warns():
    with pytest.warns(UserWarning, match=r"with noise, .* diffrax\.StepTo") as caught:
        path_of(jax.random.key(0), 0.25, isotropic, 3, saveat=diffrax.SaveAt(ts=[0.3]))
    assert {warning.filename for warning in caught} == {__file__}


def test_methods_and_terms_that_do_not_fit_are_refused():
    key = jax.random.key(0)
    for name, word in (("LieEuler", "order two"), ("CFM4", "nonlinear")):
        refuses(ValueError, word, path_of, key, 0.125, isotropic, 3, name=name)
    refuses(ValueError, "g must", path_of, key, 0.125, lambda t, y, args: jnp.ones(3), 3)
    refuses(ValueError, r"path must have shape \(3,\)", path_of, key, 0.125, isotropic, 2)
    refuses(ValueError, "terms without noise", path_of, key, None, isotropic, 3, name="CF5(4)")
    controller = diffrax.PIDController(1e-3, 1e-3)
    with pytest.raises(RuntimeError, match="error estimates"):
        path_of(key, 0.125, isotropic, 3, name="CF5(4)", stepsize_controller=controller)
    term = cg.jax.FrameTerm(lambda t, y, args: jnp.zeros(3), SO3())
    for terms in ((term, term), (term, diffrax.ODETerm(lambda t, y, args: y))):
        with pytest.raises(TypeError, match="NoiseTerm"):
            diffrax.diffeqsolve(
                diffrax.MultiTerm(*terms), cg.jax.Solver("CF4"), 0.0, 1.0, 0.1, jnp.eye(3)
            )
    refuses(TypeError, "path must", cg.jax.NoiseTerm, isotropic, lambda t: t, SO3())
