"""Solutions on further frames, errors of long steps, and solvers that are stored."""

import pickle

import numpy as np
import pytest
from jax_problems import point, solve, term
from jax_setup import diffrax, jax
from slow_cases import slow

import cg
from cg import frames as fr

eqx = pytest.importorskip("equinox")
jnp = jax.numpy
CASES = [
    (fr.Hyperbolic(2), "RKMK4"),
    (fr.Grassmann(3, 1), "CF4"),
    *slow(
        (fr.SPD(2), "CF4"),
        (fr.SL(2), "RKMK4"),
        (fr.Sp(2, "body"), "CG4"),
        (fr.IsospectralOrbit((0.0, 0.0, 1.0)), "CF4"),
        (fr.IsospectralOrbit((-1.0, 1.0), hermitian=True), "CG4"),
    ),
]

pytestmark = pytest.mark.filterwarnings("ignore:Complex dtype support in Diffrax")


@pytest.mark.parametrize(("frame", "name"), CASES, ids=repr)
def test_solutions(frame, name):
    """The order is four, points stay on the manifold, and gradients are those of both modes."""
    ours, f = term(frame)
    y0, factors = point(frame), np.array([0.4, 0.7])
    solver = cg.jax.Solver(name, dense="steps")

    def end(h, factor, adjoint):
        return solve(ours, solver, y0, h=h, args=factor, max_steps=64, adjoint=adjoint).ys[-1]

    @jax.jit
    def batch(h):
        return jax.vmap(lambda factor: end(h, factor, diffrax.DirectAdjoint()))(factors)

    exact = [
        cg.solve_ivp(
            f, (0.0, 1.0), y0, frame=frame, rtol=1e-12, atol=1e-12, args=(factor,), method="CF5(4)"
        ).y[-1]
        for factor in factors
    ]
    ends = [batch(1 / steps) for steps in (16, 32)]
    errors = [np.abs(y - np.stack(exact)).max() for y in ends]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)
    assert np.asarray(frame.relative_error(np.asarray(ends[1]))).max() < 1e-13

    def cost(factor, adjoint):
        return jnp.abs(end(0.1, factor, adjoint)[..., 0]).sum()

    reverse = jax.jit(jax.grad(lambda s: cost(s, diffrax.RecursiveCheckpointAdjoint())))(0.7)
    shifted = jax.jit(lambda s: cost(s, diffrax.DirectAdjoint()))
    slope = (shifted(0.7 + 1e-5) - shifted(0.7 - 1e-5)) / 2e-5
    assert float(reverse) == pytest.approx(float(slope), abs=1e-8)


@pytest.mark.parametrize(
    "frame",
    [
        *(
            fr.SO3(),
            fr.SU(2),
            fr.UnitQuaternion(),
            fr.Sphere(2),
            fr.Power(fr.Sphere(2), 3),
            fr.SO(4),
            fr.Grassmann(3, 1),
        ),
        *(fr.Product(fr.Euclidean(1), fr.SO3()), fr.IsospectralOrbit((-1.0, 1.0), hermitian=True)),
    ],
    ids=repr,
)
@pytest.mark.parametrize("name", ["CF5(4)", "RKMK5(4)"])
def test_estimates_of_long_turns_are_not_believed(frame, name):
    """Beyond 20 radians the error is no less than the change of the coefficients."""
    rng = np.random.default_rng(2)
    axis, change = rng.standard_normal((2, frame.dim))
    axis /= np.sqrt(sum(axis[-3:] ** 2))
    solver, y0 = cg.jax.Solver(name, dense="steps"), jnp.asarray(point(frame))

    def error(angle, factor):
        f = cg.jax.FrameTerm(lambda t, y, s: angle * axis + s * (t > 0.0) * change, frame)
        return solver.step(f, 0.0, 1.0, y0, factor, jnp.asarray(angle * axis), False)

    error = jax.jit(error)
    for angle in (50.0, 100.0):
        y1, estimate, *_ = error(angle, 1e-2)
        if np.isfinite(y1).all():  # dexpinv doesn't exist beyond a turn
            assert np.linalg.norm(estimate) >= 0.9 * np.linalg.norm(frame.field(1e-2 * change, y1))
    y1, estimate, *_ = error(100.0, 0.0)  # constant coefficients may turn by any angle
    assert np.linalg.norm(estimate) < 1e-10


def test_stored_solvers_are_equal():
    solver = cg.jax.Solver("CF4", dense="steps")
    ours, _ = term(fr.Hyperbolic(2))
    traced = []

    @eqx.filter_jit
    def end(solver):
        traced.append(solver)
        return solve(ours, solver, point(fr.Hyperbolic(2)), h=0.5).ys

    np.testing.assert_array_equal(end(solver), end(pickle.loads(pickle.dumps(solver))))
    assert len(traced) == 1
