"""Stratonovich equations: orders, the law of rotational diffusion, manifolds, refusals."""

import numpy as np
import pytest
from jax_setup import diffrax, jax
from refusals import refuses
from slow_cases import slow

import cg
from cg.frames import SE3, SO3, Sphere

jnp = jax.numpy
STARTS = {SO3(): np.eye(3), Sphere(2): np.eye(3)[2], SE3(): np.eye(4)}


def single(t, y, args):
    return jnp.stack([y[0, 0], 0.5, y[1, 2]])[:, None]


def isotropic(t, y, args):
    return args * jnp.eye(3)


def solve(key, h, g, noises, frame=None, *, name="CF4", args=1.0, drift=None, **options):
    """Take steps of a size, or with None let an error estimate choose them."""
    frame = frame or SO3()
    path = diffrax.VirtualBrownianTree(0.0, 1.0, tol=2.0**-10, shape=(noises,), key=key)
    drift = drift or (lambda t, y, args: jnp.linspace(0.1, 0.5, frame.dim))
    terms = diffrax.MultiTerm(cg.jax.FrameTerm(drift, frame), cg.jax.NoiseTerm(g, path, frame))
    solver = cg.jax.Solver(name, dense="steps")
    y0 = STARTS[frame]
    if h is None:
        options["stepsize_controller"] = cg.jax.controller(frame, 1e-3, 1e-3)
    return diffrax.diffeqsolve(terms, solver, 0.0, 1.0, h, y0, args, **options).ys[-1]


def batch(number, *arguments, **options):
    """Return a function of the number of steps, which gives the ends of many paths."""
    keys = jax.random.split(jax.random.key(1), number)
    paths = jax.jit(
        jax.vmap(lambda key, h: solve(key, h, *arguments, **options), in_axes=(0, None))
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
    options = {"saveat": diffrax.SaveAt(ts=[0.3])}
    with pytest.warns(UserWarning, match=r"With noise .* diffrax\.StepTo"):
        solve(jax.random.key(0), 0.25, isotropic, 3, name="CF3", **options)


def test_methods_and_terms_that_do_not_fit_are_refused():
    key = jax.random.key(0)
    for name, word in (("LieEuler", "order two"), ("CFM4", "nonlinear")):
        refuses(ValueError, word, solve, key, 0.125, isotropic, 3, name=name)
    refuses(ValueError, "g must", solve, key, 0.125, lambda t, y, args: jnp.ones(3), 3)
    refuses(ValueError, r"path must have shape \(3,\)", solve, key, 0.125, isotropic, 2)
    refuses(ValueError, "terms without noise", solve, key, None, isotropic, 3, name="CF5(4)")
    controller = diffrax.PIDController(1e-3, 1e-3)
    with pytest.raises(RuntimeError, match="error estimates"):
        solve(key, 0.125, isotropic, 3, name="CF5(4)", stepsize_controller=controller)
    term = cg.jax.FrameTerm(lambda t, y, args: jnp.zeros(3), SO3())
    for terms in ((term, term), (term, diffrax.ODETerm(lambda t, y, args: y))):
        with pytest.raises(TypeError, match="NoiseTerm"):
            diffrax.diffeqsolve(
                diffrax.MultiTerm(*terms), cg.jax.Solver("CF4"), 0.0, 1.0, 0.1, jnp.eye(3)
            )
    refuses(TypeError, "path must", cg.jax.NoiseTerm, isotropic, lambda t: t, SO3())
