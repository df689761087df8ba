"""Derivatives of solutions in JAX, batches, and traced arguments."""

from functools import partial

import numpy as np
import pytest
from jax_problems import ATTITUDE_AND_VELOCITY, INERTIA, START, body, point, solve, term
from jax_setup import diffrax, jax
from quotients import derivative
from refusals import refuses
from slow_cases import slow

import cg
from cg import frames as fr
from cg.frames import GL, SE3, SO, SO3, SU, Euclidean, Power, Product, Sphere, UnitQuaternion

jnp = jax.numpy
SHIFTS = np.outer([1.0, -1.0], 0.02 * 0.5 ** np.arange(8)).ravel()  # all that derivatives ask for

pytestmark = pytest.mark.filterwarnings("ignore:Complex dtype support in Diffrax")


class TestTransforms:
    """Derivatives of end points of adaptive runs against difference quotients."""

    @pytest.mark.parametrize(("frame", "name"), [
        (fr.UnitQuaternion(), "CF4(3)"),
        *slow((fr.UnitQuaternion(), "RKMK5(4)"), (fr.Sphere(2), "CF4(3)")),
    ])  # fmt: skip
    def test_times_of_events(self, frame, name):
        """The time of an event and the point there, and their derivatives."""
        optimistix = pytest.importorskip("optimistix")
        ours, f = term(frame)
        y0 = point(frame)
        event = diffrax.Event(
            lambda t, y, args, **kwargs: y[0] - y[-1], root_finder=optimistix.Newton(1e-11, 1e-11)
        )

        def end(factor):
            options = {"h": 0.05, "end": 4.0, "event": event, "max_steps": 512}
            solution = solve(ours, cg.jax.Solver(name), y0, args=factor, **options)
            return jnp.concatenate([solution.ts, solution.ys[0]])

        @jax.jit
        def both(factor):
            values, back = jax.vjp(end, factor)
            return values, jax.vmap(back)(jnp.eye(len(values)))[0]

        exact = cg.solve_ivp(
            f, (0.0, 4.0), y0, frame=frame, args=(0.8,), rtol=1e-10, atol=1e-10,
            events=cg.Event(lambda t, y, factor: y[0] - y[-1], terminal=True),
        )  # fmt: skip
        assert 0.1 < exact.t[-1] < 3.9
        values, slope = both(0.8)
        np.testing.assert_allclose(values, [exact.t[-1], *exact.y[-1]], rtol=0.0, atol=1e-7)
        expected = derivative(lambda s: both(0.8 + s)[0], bound=1e-10)
        np.testing.assert_allclose(slope, expected, rtol=0.0, atol=1e-10)

    def test_steps_longer_than_a_turn_do_not_pass_over_events(self):
        optimistix = pytest.importorskip("optimistix")
        frame = fr.SO3()

        @partial(jax.jit, static_argnums=2)
        def end(angle, power, sees=True):
            return diffrax.diffeqsolve(
                cg.jax.FrameTerm(lambda t, y, args: jnp.stack([0.0, 0.0, t**power]), frame),
                cg.jax.Solver("CF5(4)"), 0.0, 500.0, None, jnp.eye(3),
                stepsize_controller=cg.jax.controller(frame, 1e-9, 1e-9), max_steps=10000,
                event=diffrax.Event(
                    lambda t, y, args, **kwargs: y[1, 0] - jnp.sin(angle),
                    optimistix.Newton(1e-10, 1e-10), True,
                ) if sees else None,
            )  # fmt: skip

        for angle in (-1.2, -0.5, 0.5, 1.0):
            first = angle % (2.0 * np.pi)  # where the sine increases
            np.testing.assert_allclose(end(angle, 0.0).ts[0], first, rtol=0.0, atol=3e-14)
        np.testing.assert_allclose(end(1.0, 1.0).ts[0], np.sqrt(2.0), rtol=0.0, atol=1e-14)
        assert end(1.0, 0.0, sees=False).stats["num_steps"] < 20

    @pytest.mark.parametrize("frame", [
        fr.Sphere(2), *slow(fr.SO3(), fr.UnitQuaternion(), fr.SE3(), fr.SU(3), fr.SL(2)),
        *slow(fr.Stiefel(3, 2), fr.Power(fr.Sphere(2), 2), fr.Grassmann(3, 1), fr.SPD(2)),
        *slow(fr.Product(fr.SU(2), fr.Euclidean(2)), fr.Hyperbolic(2), fr.Sp(2, "body")),
        *slow(fr.IsospectralOrbit((-1.0, 1.0), hermitian=True)),
    ], ids=repr)  # fmt: skip
    @pytest.mark.parametrize("name", ["CF3", *slow("RKMK4")])
    def test_all_transforms(self, frame, name):
        """Derivatives of a step and a point within, in both modes, of two orders and batched."""
        ours, _ = term(frame)
        solver, h = cg.jax.Solver(name), 0.25
        y0 = jnp.asarray(point(frame))

        def cost(factor):
            state = solver.init(ours, 0.0, h, y0, factor)
            y, _, _, state, _ = solver.step(ours, 0.0, h, y0, factor, state, False)
            y, _, dense, *_ = solver.step(ours, h, 2.0 * h, y, factor, state, False)
            points = jnp.stack([y, dense["within"](jnp.asarray(0.4))]).reshape(2, -1)
            return (jnp.abs(points[:, 0] - 0.3) ** 2).sum()

        transforms = jax.value_and_grad(cost), jax.jacfwd(cost), jax.hessian(cost)
        batch = jax.jit(jax.vmap(lambda factor: [transform(factor) for transform in transforms]))
        (values, slopes), forward, curvatures = jax.tree.map(
            np.asarray, batch(0.8 + np.append(0.0, SHIFTS))
        )
        np.testing.assert_allclose(forward, slopes, rtol=2e-14)
        for function, actual in ((values, slopes[0]), (slopes, curvatures[0])):
            given = dict(zip(SHIFTS, function[1:], strict=True))
            bound = 1e-10 * abs(actual)
            assert abs(derivative(given.__getitem__, bound) - actual) < bound

    def test_ends_of_the_span(self):
        frame = fr.Euclidean(1)

        def last(begin, end):
            return solve(
                cg.jax.FrameTerm(lambda t, y, args: t * y, frame),
                cg.jax.Solver("BS3(2)"), np.ones(1), begin=begin, end=end,
                adjoint=diffrax.ForwardMode(),
            ).ys[-1, 0]  # fmt: skip

        values = jax.jit(lambda *span: (last(*span), jax.jacfwd(last, (0, 1))(*span)))
        for begin, end in ((0.25, 1.0), (1.0, 0.25)):
            value, slopes = values(begin, end)
            np.testing.assert_allclose(slopes, [-begin * value, end * value], rtol=1e-4)

    def test_first_steps(self):
        """Their sizes are held fixed; one to the end of the span moves with it."""
        frame = fr.UnitQuaternion()

        def first(rate, end):
            ours = cg.jax.FrameTerm(lambda t, y, args: rate * jnp.ones(3), frame)
            steps, func = cg.jax.controller(frame, 1e-3, 1e-3), cg.jax.Solver("CF5(4)").func
            times = jnp.zeros(()), jnp.asarray(end)
            return steps.init(ours, *times, jnp.eye(4)[3], None, None, func, 4.0)[0]

        transforms = jax.jit(
            lambda *x: (first(*x), jax.jacfwd(first, (0, 1))(*x), jax.jacrev(first, (0, 1))(*x))
        )
        for end, moves in ((1e-3, 1.0), (10.0, 0.0)):
            size, *slopes = transforms(0.5, end)
            assert (size == end) == bool(moves)
            assert slopes == [(0.0, moves)] * 2

    def test_errors_in_gradients_of_solve_ivp_name_cg_jax(self):
        def end(inertia):
            f = body(jnp)
            return cg.solve_ivp(
                lambda t, y: f(t, y, inertia), (0.0, 1.0), START, frame=ATTITUDE_AND_VELOCITY
            ).y[-1, 0]

        def from_start(y0):
            return cg.solve_ivp(body(np), (0.0, 1.0), y0, frame=ATTITUDE_AND_VELOCITY).y[-1, 0]

        for function, at in ((end, INERTIA), (from_start, START)):
            with pytest.raises(ValueError, match=r"cg\.jax has the methods for JAX"):
                jax.grad(function)(jnp.asarray(at))
            with pytest.raises(ValueError, match=r"cg\.jax has the methods for JAX"):
                jax.jit(function)(jnp.asarray(at))


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
    rate = jax.jit(cg.jax.divergence(f, frame))
    start, end = (rate(t, jnp.asarray(p), 0.5) for t, p in ((0.0, y), (eps, run.y[-1])))
    assert float(start + end) * eps / 2 == pytest.approx(expected, abs=2e-11)


@pytest.mark.parametrize("frame", [SO3(), Sphere(2)], ids=repr)
def test_estimates_have_the_divergence_as_mean(frame):
    f = field(frame)
    y = jnp.asarray(frame.random_point(np.random.default_rng(4)))
    exact = float(jax.jit(cg.jax.divergence(f, frame))(0.2, y, 0.5))

    estimate = lambda key: cg.jax.divergence(f, frame, key=key)(0.2, y, 0.5)
    estimates = jax.jit(jax.vmap(estimate))(jax.random.split(jax.random.key(1), 4000))
    assert abs(estimates.mean() - exact) < 4 * estimates.std() / 4000**0.5 + 1e-6


def test_fields_of_the_user_are_refused():
    for kind in (cg.frames.MatrixFrame, cg.frames.LinearAction):
        own = kind([[[1.0, -1.0], [1.0, 0.0]]])
        with pytest.raises(ValueError, match="invariant volume"):
            cg.jax.divergence(lambda t, y, a: y, Product(Euclidean(1), own))
    refuses(TypeError, "f must", cg.jax.divergence, 3, SO3())


def test_functions_and_points_are_checked():
    north = np.array([0, 0, 1])
    with pytest.raises(ValueError, match=r"f must return 3 real numbers"):
        cg.jax.divergence(lambda t, y, args: y[:2], Sphere(2))(0.0, north, None)
    with pytest.raises(ValueError, match="y must have shape"):
        cg.jax.divergence(lambda t, y, args: y, Sphere(2))(0.0, north[:2], None)
