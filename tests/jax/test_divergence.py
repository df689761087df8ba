"""Divergences, by Liouville's formula, by derivatives of the whole flow, and by known fields."""

import numpy as np
import pytest
from jax_setup import jax

import cg
from cg.frames import GL, SE3, SO, SO3, SU, Euclidean, Power, Product, Sphere, UnitQuaternion

jnp = jax.numpy

FRAMES = [
    SO3(), SO3("space"), UnitQuaternion(), SE3(), SO(4), SU(2), GL(2), Euclidean(3),
    Product(UnitQuaternion(), Euclidean(2)), Power(SO3(), 2),
]  # fmt: skip


def field(frame):
    rng = np.random.default_rng(3)
    size = int(np.prod(frame.point_shape))
    first, second = rng.standard_normal((2, frame.dim, size)) / size**0.5

    def f(t, y, args=None):
        flat = jnp.real(y.reshape(-1)) + 0.3 * jnp.imag(y.reshape(-1))
        return jnp.sin(first @ flat + t) + args * (second @ flat) ** 2

    return f


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_transition_matrices_change_by_the_divergence(frame):
    """Liouville: the logarithm of the determinant is the integral of the divergence."""
    f, y = field(frame), np.asarray(frame.random_point(np.random.default_rng(4)))
    call = jax.jit(f)
    eps = 1e-4
    run = cg.solve_variational(
        lambda t, y: np.asarray(call(t, y, 0.5)), (0, eps), y, frame=frame, h=eps, method="CF4"
    )
    expected = np.linalg.slogdet(run.transition[-1])[1]
    start, end = (
        cg.jax.divergence(f, frame)(t, jnp.asarray(p), 0.5) for t, p in ((0, y), (eps, run.y[-1]))
    )
    assert float(start + end) * eps / 2 == pytest.approx(expected, abs=2e-11)


@pytest.mark.parametrize("frame", [SO3(), Sphere(2)], ids=repr)
def test_estimates_have_the_divergence_as_mean(frame):
    f = field(frame)
    y = jnp.asarray(frame.random_point(np.random.default_rng(4)))
    exact = float(cg.jax.divergence(f, frame)(0.2, y, 0.5))

    estimate = lambda key: cg.jax.divergence(f, frame, key=key)(0.2, y, 0.5)
    estimates = np.asarray(jax.vmap(estimate)(jax.random.split(jax.random.key(1), 4000)))
    assert abs(estimates.mean() - exact) < 4 * estimates.std() / 4000**0.5 + 1e-6


def test_fields_of_the_user_are_refused():
    for kind in (cg.frames.MatrixFrame, cg.frames.LinearAction):
        own = kind([[[1.0, -1.0], [1.0, 0.0]]])
        with pytest.raises(ValueError, match="invariant volume"):
            cg.jax.divergence(lambda t, y, a: y, Product(Euclidean(1), own))
    with pytest.raises(TypeError, match="f must"):
        cg.jax.divergence(3, SO3())


def test_functions_and_points_are_checked():
    north = np.array([0, 0, 1])
    with pytest.raises(ValueError, match=r"f must return 3 real numbers"):
        cg.jax.divergence(lambda t, y, args: y[:2], Sphere(2))(0.0, north, None)
    with pytest.raises(ValueError, match="y must have shape"):
        cg.jax.divergence(lambda t, y, args: y, Sphere(2))(0.0, north[:2], None)
    rate = cg.jax.divergence(lambda t, y, args: jnp.cross(y, north), Sphere(2))
    assert rate(0.0, north, None) == -2.0
