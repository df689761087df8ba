"""Derivatives of solutions in JAX, batches, and traced arguments."""

from functools import partial

import numpy as np
import pytest
from jax_problems import ATTITUDE_AND_VELOCITY, INERTIA, START, body, point, solve, term
from jax_setup import diffrax, jax
from quotients import derivative
from slow_cases import slow

import cg
from cg import frames as fr

jnp = jax.numpy
SHIFTS = np.outer([1.0, -1.0], 0.02 * 0.5 ** np.arange(8)).ravel()  # all that derivatives ask for

pytestmark = pytest.mark.filterwarnings("ignore:Complex dtype support in Diffrax")


class TestTransforms:
    """Derivatives of end points of adaptive runs against difference quotients."""

    STEPS = 1024
    KEPT = diffrax.RecursiveCheckpointAdjoint(checkpoints=STEPS)

    def end(self, inertia, y0=START, adjoint=KEPT):
        ours = cg.jax.FrameTerm(body(jnp), ATTITUDE_AND_VELOCITY)
        solver = cg.jax.Solver("RKMK5(4)", dense="steps")
        options = {"max_steps": self.STEPS, "adjoint": adjoint, "args": inertia}
        return solve(ours, solver, y0, end=2.0, rtol=1e-12, **options).ys[-1]

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

        values = jax.jit(end)
        exact = cg.solve_ivp(
            f, (0.0, 4.0), y0, frame=frame, args=(0.8,), rtol=1e-10, atol=1e-10,
            events=cg.Event(lambda t, y, factor: y[0] - y[-1], terminal=True),
        )  # fmt: skip
        assert 0.1 < exact.t[-1] < 3.9
        np.testing.assert_allclose(values(0.8), [exact.t[-1], *exact.y[-1]], rtol=0.0, atol=1e-7)
        slope = jax.jit(jax.jacrev(end))(0.8)
        expected = derivative(lambda s: values(0.8 + s), bound=1e-10)
        np.testing.assert_allclose(slope, expected, rtol=0.0, atol=1e-10)

    def test_steps_longer_than_a_turn_do_not_pass_over_events(self):
        optimistix = pytest.importorskip("optimistix")
        frame = fr.SO3()

        @partial(jax.jit, static_argnums=(1, 2))
        def end(angle, power=0, sees=True):
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
            np.testing.assert_allclose(end(angle).ts[0], first, rtol=0.0, atol=3e-14)
        np.testing.assert_allclose(end(1.0, power=1).ts[0], np.sqrt(2.0), rtol=0.0, atol=1e-14)
        assert end(1.0, sees=False).stats["num_steps"] < 20

    @pytest.mark.parametrize("frame", [
        fr.Sphere(2),
        *slow(fr.UnitQuaternion(), fr.SO3(), fr.SE3(), fr.SU(3), fr.SL(2), fr.Sp(2, "body")),
        *slow(fr.Stiefel(3, 2), fr.Power(fr.Sphere(2), 2), fr.Grassmann(3, 1), fr.SPD(2)),
        *slow(fr.Product(fr.SU(2), fr.Euclidean(2)), fr.Hyperbolic(2)),
        *slow(fr.IsospectralOrbit((-1.0, 1.0), hermitian=True)),
    ], ids=repr)  # fmt: skip
    @pytest.mark.parametrize("name", ["CF3", *slow("RKMK4")])
    def test_all_transforms(self, frame, name):
        """Derivatives of steps, in both modes, of two orders and batched."""
        ours, _ = term(frame)
        solver, h = cg.jax.Solver(name, dense="steps"), 0.25
        y0 = jnp.asarray(point(frame))

        def cost(factor):
            state = solver.init(ours, 0.0, h, y0, factor)
            y, _, _, state, _ = solver.step(ours, 0.0, h, y0, factor, state, False)
            y, *_ = solver.step(ours, h, 2.0 * h, y, factor, state, False)
            return jnp.abs(y.reshape(-1)[0] - 0.3) ** 2

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

    @pytest.mark.parametrize(("begin", "end"), [(0.25, 1.0), (1.0, 0.25)])
    def test_ends_of_the_span(self, begin, end):
        frame = fr.Euclidean(1)

        def last(begin, end):
            return solve(
                cg.jax.FrameTerm(lambda t, y, args: t * y, frame),
                cg.jax.Solver("BS3(2)", dense="steps"), np.ones(1), begin=begin, end=end,
                adjoint=diffrax.ForwardMode(),
            ).ys[-1, 0]  # fmt: skip

        value, slopes = last(begin, end), jax.jacfwd(last, (0, 1))(begin, end)
        np.testing.assert_allclose(slopes, [-begin * value, end * value], rtol=1e-4)

    def test_first_steps(self):
        """Their sizes are held fixed; one to the end of the span moves with it."""
        frame = fr.UnitQuaternion()

        def first(rate, end):
            ours = cg.jax.FrameTerm(lambda t, y, args: rate * jnp.ones(3), frame)
            steps, func = cg.jax.controller(frame, 1e-3, 1e-3), cg.jax.Solver("CF5(4)").func
            times = jnp.zeros(()), jnp.asarray(end)
            return steps.init(ours, *times, jnp.eye(4)[3], None, None, func, 4.0)[0]

        for end, moves in ((1e-3, 1.0), (10.0, 0.0)):
            assert (first(0.5, end) == end) == bool(moves)
            for transform in (jax.jacfwd, jax.jacrev):
                assert transform(first, (0, 1))(0.5, end) == (0.0, moves)

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
