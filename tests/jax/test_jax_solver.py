"""Steps, errors and output in JAX are those of compiled code."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from jax_setup import diffrax, jax
from slow_cases import slow

import cg
from cg.catalogue import munthe_kaas
from cg.frames import (
    SE3,
    SO,
    SO3,
    SU,
    Euclidean,
    FieldFrame,
    Power,
    Product,
    Semidirect,
    Sphere,
    Stiefel,
    U,
    UnitQuaternion,
)

jnp = jax.numpy
METHODS = {**cg.methods, **munthe_kaas}
EXPLICIT = [name for name, method in METHODS.items() if method.explicit]
ATTITUDE_AND_VELOCITY = Product(UnitQuaternion(), Euclidean(3))
INERTIA = np.array([1.0, 2.0, 2.5])
START = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 2.0, -0.5])

pytestmark = pytest.mark.filterwarnings("ignore:Complex dtype support in Diffrax")


def body(xp):
    """Return the right-hand side of a body without torques."""

    def f(t, y, inertia=INERTIA):
        velocity = y[4:]
        return xp.concatenate([velocity, xp.cross(inertia * velocity, velocity) / inertia])

    return f


def winding(frame, xp):
    """Return a right-hand side that sees time and all entries of a point."""
    rng = np.random.default_rng(0)
    count = int(np.prod(frame.point_shape))
    weights = rng.standard_normal((frame.dim, count)) / np.sqrt(count)
    phases = rng.uniform(0.0, 6.0, frame.dim)

    def f(t, y, factor=1.0):
        flat = y.reshape(-1)
        numbers = flat.real + flat.imag if frame.dtype.kind == "c" else flat
        return factor * (xp.cos(t + phases) + weights @ xp.sin(numbers))

    return f


def term(frame, f=None):
    """Return a term of a right-hand side, and the same for NumPy."""
    return cg.jax.FrameTerm(f or winding(frame, jnp), frame), winding(frame, np)


def point(frame):
    return frame.random_point(np.random.default_rng(7))


def solve(term, solver, y0, *, h=None, end=1.0, rtol=1e-6, max_steps=4096, **options):
    """Return the solution of diffrax, with fixed steps or those of `cg.jax.controller`."""
    if h is None:
        options["stepsize_controller"] = cg.jax.controller(term.frame, rtol, rtol)
    return diffrax.diffeqsolve(
        term, solver, 0.0, end, h, y0, max_steps=max_steps, **{"args": 1.0, **options}
    )


class TestSteps:
    @pytest.mark.parametrize("name", EXPLICIT)
    def test_all_methods(self, name):
        frame = UnitQuaternion()
        ours, f = term(frame)
        solver = cg.jax.Solver(name, dense="steps")
        y0, h = point(frame), 0.1
        y = jnp.asarray(y0)
        state = solver.init(ours, 0.0, h, y, 1.0)
        for k in range(2):
            y, _, _, state, _ = solver.step(ours, k * h, (k + 1) * h, y, 1.0, state, False)
        expected = cg.integrate(f, (0.0, 2 * h), y0, frame=frame, method=name, h=h).y[-1]
        np.testing.assert_allclose(y, expected, rtol=0.0, atol=1e-13)

    @pytest.mark.parametrize(
        "frame",
        [
            *(SE3(), Sphere(2), Stiefel(3, 2), Product(SU(2), Euclidean(2))),
            *slow(
                SO3("space"), SU(3), Power(Sphere(2), 2), Semidirect(SO3(), 2), SO(4), SO(2), U(2)
            ),
        ],
        ids=repr,
    )
    @pytest.mark.parametrize("name", ["CF4(3)", *slow("RKMK5(4)")])
    def test_all_frames_between_steps_too(self, frame, name):
        ours, f = term(frame)
        ts = np.linspace(0.0, 0.5, 7)
        y0 = point(frame)
        solver = cg.jax.Solver(name)
        found = solve(ours, solver, y0, h=0.1, end=0.5, saveat=diffrax.SaveAt(ts=ts))
        expected = cg.solve_ivp(f, (0.0, 0.5), y0, frame=frame, method=name, h=0.1, t_eval=ts)
        np.testing.assert_allclose(found.ys, expected.y, rtol=0.0, atol=1e-13)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", EXPLICIT)
    @pytest.mark.parametrize("frame", [SE3(), Sphere(2), SU(2)], ids=repr)
    def test_all_methods_on_frames(self, frame, name):
        if METHODS[name].exponentials > 300:
            pytest.skip("takes minutes to compile")
        self.test_all_frames_between_steps_too(frame, name)

    @pytest.mark.parametrize(
        ("name", "frame"),
        [
            ("CF3", Sphere(2)),
            *slow(("CG4", SO3())),
            ("CF5(4)", UnitQuaternion()),
            *slow(("CF6a", SE3()), ("RKMK8(5,3)", SU(2))),
        ],
    )
    def test_orders(self, name, frame):
        ours, _ = term(frame)
        y0 = point(frame)

        @jax.jit
        def end(h):
            return solve(ours, cg.jax.Solver(name, dense="steps"), y0, h=h).ys[-1]

        exact = end(1.0 / 512)
        order = METHODS[name].order
        steps = {8: (4, 8)}.get(order, (16, 32))
        errors = [float(jnp.abs(end(1.0 / n) - exact).max()) for n in steps]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)

    def test_single_precision_stays(self):
        frame = UnitQuaternion()
        y0 = jnp.asarray(point(frame), np.float32)
        solver = cg.jax.Solver("CF4(3)")
        ours, _ = term(frame)
        h = np.float32(0.1)
        state = solver.init(ours, h, h, y0, h)
        y1, error, _, state, _ = solver.step(ours, h, 2 * h, y0, h, state, False)
        assert {x.dtype for x in (y1, error, state)} == {np.dtype(np.float32)}


class TestErrors:
    @pytest.mark.parametrize(
        ("name", "rtol"),
        [
            ("RKMK8(5,3)", 1e-9),
            *slow(("RKMK8(5,3)", 1e-4)),
            ("CF5(4)", 1e-4),
            *slow(("CF5(4)", 1e-9), ("CG4(3)", 1e-6)),
        ],
    )
    def test_steps_are_those_of_solve_ivp(self, name, rtol):
        frame = ATTITUDE_AND_VELOCITY
        ours = cg.jax.FrameTerm(body(jnp), frame)
        found = solve(ours, cg.jax.Solver(name), START, end=5.0, rtol=rtol, args=INERTIA)
        expected = cg.solve_ivp(
            body(np), (0.0, 5.0), START, frame=frame, method=name, rtol=rtol, atol=rtol
        )
        assert found.stats["num_accepted_steps"] == len(expected.t) - 1
        np.testing.assert_allclose(found.ys[-1], expected.y[-1], rtol=0.0, atol=2e-12)

    @pytest.mark.parametrize(
        ("frame", "name"),
        [
            (Stiefel(3, 2), "CF4(3)"),
            *slow(
                (Stiefel(3, 2), "RKMK8(5,3)"),
                (Sphere(2), "RKMK8(5,3)"),
                (SE3(), "CF6(5)"),
                (SU(2), "CF5(4)"),
                (Product(SU(2), Euclidean(2)), "CG4(3)"),
            ),
        ],
    )
    def test_on_frames(self, frame, name):
        ours, f = term(frame)
        y0 = point(frame)
        found = solve(ours, cg.jax.Solver(name, dense="steps"), y0, end=2.0)
        expected = cg.solve_ivp(f, (0.0, 2.0), y0, frame=frame, method=name, rtol=1e-6, atol=1e-6)
        assert found.stats["num_accepted_steps"] == len(expected.t) - 1
        np.testing.assert_allclose(found.ys[-1], expected.y[-1], rtol=0.0, atol=2e-12)

    def test_plain_controllers_of_diffrax(self):
        """They compare entries."""
        frame = ATTITUDE_AND_VELOCITY
        ours = cg.jax.FrameTerm(body(jnp), frame)
        solver = cg.jax.Solver("CF5(4)", dense="steps")
        pid = diffrax.PIDController(rtol=1e-8, atol=1e-8)
        end = solve(ours, solver, START, end=2.0, h=0.01, stepsize_controller=pid, args=INERTIA)
        exact = cg.solve_ivp(body(np), (0.0, 2.0), START, frame=frame, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(end.ys[-1], exact.y[-1], rtol=0.0, atol=1e-6)

    @pytest.mark.slow
    def test_backwards(self):
        frame = ATTITUDE_AND_VELOCITY
        ours = cg.jax.FrameTerm(body(jnp), frame)
        exact = cg.solve_ivp(body(np), (0.0, 2.0), START, frame=frame, rtol=1e-12, atol=1e-12)
        steps = cg.jax.controller(frame, 1e-9, 1e-9)
        back = diffrax.diffeqsolve(
            ours, cg.jax.Solver("CF5(4)"), 2.0, 0.0, None, jnp.asarray(exact.y[-1]), INERTIA,
            stepsize_controller=steps,
        )  # fmt: skip
        np.testing.assert_allclose(back.ys[-1], START, rtol=0.0, atol=1e-7)

    def test_the_largest_step(self):
        frame = Euclidean(1)
        ours = cg.jax.FrameTerm(lambda t, y, args: 0.0 * y + 1.0, frame)
        found = diffrax.diffeqsolve(
            ours,
            cg.jax.Solver("BS3(2)"),
            0.0,
            1.0,
            None,
            jnp.zeros(1),
            stepsize_controller=cg.jax.controller(frame, 1e-3, 1e-3, max_step=0.125),
        )
        assert found.stats["num_steps"] >= 8
        assert float(found.ys[-1, 0]) == pytest.approx(1.0, abs=1e-15)


class TestOutput:
    @pytest.mark.parametrize(
        ("name", "frame"),
        [
            *slow(
                ("CF5(4)", UnitQuaternion()),
                ("CF5(4)", Sphere(2)),
                ("RKMK8(5,3)", SE3()),
                ("CF7(6)", SU(2)),
                ("CF6(5)", Stiefel(3, 2)),
            ),
        ],
    )
    def test_output_is_that_of_solve_ivp(self, name, frame):
        ours, f = term(frame)
        ts = np.linspace(0.0, 2.0, 23)
        y0 = point(frame)
        found = solve(ours, cg.jax.Solver(name), y0, end=2.0, saveat=diffrax.SaveAt(ts=ts))
        expected = cg.solve_ivp(
            f, (0.0, 2.0), y0, frame=frame, method=name, rtol=1e-6, atol=1e-6, t_eval=ts
        )
        np.testing.assert_allclose(found.ys, expected.y, rtol=0.0, atol=1e-12)

    def test_dense_output_and_events(self):
        frame = UnitQuaternion()
        ours, f = term(frame)
        y0 = point(frame)
        optimistix = pytest.importorskip("optimistix")
        event = diffrax.Event(
            lambda t, y, args, **kwargs: y[0] - y[3], root_finder=optimistix.Newton(1e-11, 1e-11)
        )
        found = solve(
            ours,
            cg.jax.Solver("CF4(3)"),
            y0,
            end=4.0,
            rtol=1e-7,
            event=event,
            saveat=diffrax.SaveAt(t1=True, dense=True),
        )
        expected = cg.solve_ivp(
            f, (0.0, 4.0), y0, frame=frame, method="CF4(3)", rtol=1e-7, atol=1e-7,
            events=cg.Event(lambda t, y: y[0] - y[3], terminal=True), dense_output=True,
        )  # fmt: skip
        assert float(found.ts[-1]) == pytest.approx(expected.t[-1], abs=1e-9)
        t = 0.37 * expected.t[-1]
        np.testing.assert_allclose(found.evaluate(t), expected.sol(t), rtol=0.0, atol=1e-11)

    def test_the_cheap_form(self):
        """It has the ends of the steps, and an error of second order between them."""
        frame = Sphere(2)
        ours, _ = term(frame)
        y0 = point(frame)

        @jax.jit
        def largest(h):
            ts = jnp.array([0.0, 0.5 * h, h])
            options = {"h": h, "end": h, "saveat": diffrax.SaveAt(ts=ts)}
            cheap, accurate = (
                solve(ours, cg.jax.Solver("CF3", dense=dense), y0, **options).ys
                for dense in ("steps", "accurate")
            )
            return jnp.abs(cheap - accurate).max(axis=1)

        one, half = largest(0.1), largest(0.05)
        np.testing.assert_allclose(one[::2], 0.0, atol=1e-14)
        assert np.log2(one[1] / half[1]) == pytest.approx(2.0, abs=0.2)


class TestOwnFrames:
    def test_a_flow_in_jax(self):
        def frame(xp):
            return FieldFrame(
                [lambda y: xp.stack([y[0], -y[1]])],
                lambda v, y: xp.stack([y[0] * xp.exp(v[0]), y[1] * xp.exp(-v[0])]),
                point_shape=2,
            )

        ours, f = term(frame(jnp))
        ts = np.linspace(0.0, 1.0, 5)
        y0 = np.array([1.0, 2.0])
        found = solve(ours, cg.jax.Solver("CF4(3)"), y0, saveat=diffrax.SaveAt(ts=ts))
        expected = cg.solve_ivp(
            f, (0.0, 1.0), y0, frame=frame(np), method="CF4(3)", rtol=1e-6, atol=1e-6, t_eval=ts
        )
        np.testing.assert_allclose(found.ys, expected.y, rtol=0.0, atol=1e-12)

    def test_without_brackets(self):
        frame = FieldFrame(
            [lambda y: jnp.stack([y[1], 0.0 * y[0]]), lambda y: jnp.stack([0.0 * y[0], y[0]])],
            lambda v, y: y + v,
            point_shape=2,
        )
        ours, _ = term(frame)
        with pytest.raises(ValueError, match="which needs brackets"):
            solve(ours, cg.jax.Solver("RKMK4"), np.ones(2), h=0.1)


class TestTransforms:
    """Derivatives of ends of adaptive runs, against each other and against difference quotients."""

    STEPS = 1024
    KEPT = diffrax.RecursiveCheckpointAdjoint(checkpoints=STEPS)

    def end(self, inertia, y0=START, adjoint=KEPT):
        ours = cg.jax.FrameTerm(body(jnp), ATTITUDE_AND_VELOCITY)
        solver = cg.jax.Solver("RKMK5(4)", dense="steps")
        options = {"max_steps": self.STEPS, "adjoint": adjoint, "args": inertia}
        return solve(ours, solver, y0, end=2.0, rtol=1e-12, **options).ys[-1]

    def test_gradients(self):
        inertia, y0 = jnp.asarray(INERTIA), jnp.asarray(START)
        both = jax.grad(lambda i, y: self.end(i, y)[0], argnums=(0, 1))
        by_inertia, by_point = jax.jit(both)(inertia, y0)
        forward = jax.jit(jax.jacfwd(lambda i: self.end(i, adjoint=diffrax.ForwardMode())[0]))
        np.testing.assert_allclose(by_inertia, forward(inertia), rtol=0.0, atol=1e-11)
        frame = ATTITUDE_AND_VELOCITY

        def exact(inertia, y0):
            solution = cg.solve_ivp(
                body(np), (0.0, 2.0), y0, frame=frame, rtol=1e-13, atol=1e-13, args=(inertia,)
            )
            return solution.y[-1, 0]

        for k, unit in enumerate(np.eye(3)):
            quotient = self.quotient(lambda s, u=unit: exact(INERTIA + s * u, START))
            assert float(by_inertia[k]) == pytest.approx(quotient, abs=1e-9)
        numbers = cg.jax.cotangent(frame, y0, by_point)
        for k, unit in enumerate(np.eye(6)):
            quotient = self.quotient(lambda s, u=unit: exact(INERTIA, frame.flow(s * u, START)))
            assert float(numbers[k]) == pytest.approx(quotient, abs=1e-9)

    @pytest.mark.parametrize(
        ("frame", "name"),
        [
            (UnitQuaternion(), "CF4(3)"),
            *slow((UnitQuaternion(), "RKMK5(4)"), (Sphere(2), "CF4(3)")),
        ],
    )
    def test_times_of_events(self, frame, name):
        """The derivative of the time of an event, and of the point there."""
        optimistix = pytest.importorskip("optimistix")
        ours, _ = term(frame)
        y0 = point(frame)
        event = diffrax.Event(
            lambda t, y, args, **kwargs: y[0] - y[-1], root_finder=optimistix.Newton(1e-11, 1e-11)
        )
        options = {"end": 4.0, "event": event, "max_steps": 512}

        def found(factor):
            solver = cg.jax.Solver(name)
            run = solve(ours, solver, y0, h=0.05, args=factor, **options)
            return jnp.concatenate([run.ts, run.ys[0]])

        values = jax.jit(found)
        slope = jax.jit(jax.jacrev(found))(0.8)
        assert 0.1 < float(values(0.8)[0]) < 3.9
        expected = self.quotient(lambda s: np.asarray(values(0.8 + s)), 5e-3)
        np.testing.assert_allclose(slope, expected, rtol=0.0, atol=1e-7)

    def test_flows_are_compiled_once(self):
        """Without barriers XLA compiles a flow again with each consumer, with other rounding."""
        frame = UnitQuaternion()
        ours, _ = term(frame)
        y0 = point(frame)
        solver = cg.jax.Solver("CF4(3)", dense="steps")

        def step(y0, first):
            return solver.step(ours, 0.0, 0.1, y0, 1.0, first, False)[:2]

        primitives = [str(e.primitive) for e in jax.make_jaxpr(step)(y0, np.ones(3)).eqns]
        flows = sum(len(path.flows) for path in solver.steps.paths.paths)
        assert primitives.count("optimization_barrier") == flows

    @pytest.mark.slow
    def test_repeated_steps_are_the_same(self):
        """The default adjoint repeats steps; their sizes follow from differences near rounding.

        Only XLA with its usual optimisations, which tests do without, shows whether they differ.
        """
        environment = {name: text for name, text in os.environ.items() if name != "XLA_FLAGS"}
        command = [sys.executable, Path(__file__).parents[1] / "helpers/jax_repetition.py"]
        done = subprocess.run(command, env=environment, capture_output=True, check=True, text=True)
        assert abs(float(done.stdout)) < 1e-12

    @staticmethod
    def quotient(function, step=5e-3):
        """Return a derivative by differences of order six."""
        weights = {1: 0.75, 2: -0.15, 3: 1.0 / 60.0}
        return (
            sum(
                weight * (function(k * step) - function(-k * step)) for k, weight in weights.items()
            )
            / step
        )

    def test_tolerances_may_be_traced(self):
        frame = UnitQuaternion()
        ours, _ = term(frame)

        def end(rtol):
            return solve(ours, cg.jax.Solver("BS3(2)", dense="steps"), point(frame), rtol=rtol).ys

        np.testing.assert_allclose(jax.jit(end)(1e-4), end(1e-4), rtol=0.0, atol=1e-13)

    def test_members_are_single_runs(self):
        inertias = jnp.asarray(INERTIA) * jnp.array([[1.0], [2.0], [0.5]]) + jnp.eye(3)
        together = jax.jit(jax.vmap(self.end))(inertias)
        alone = jax.jit(self.end)
        for inertia, found in zip(inertias, together, strict=True):
            np.testing.assert_allclose(found, alone(inertia), rtol=0.0, atol=1e-11)

    @pytest.mark.parametrize(
        "frame",
        [
            Sphere(2),
            *slow(
                UnitQuaternion(),
                SO3(),
                SE3(),
                SU(3),
                Stiefel(3, 2),
                Power(Sphere(2), 2),
                Product(SU(2), Euclidean(2)),
            ),
        ],
        ids=repr,
    )
    def test_second_derivatives(self, frame):
        ours, _ = term(frame)
        y0 = point(frame)
        adjoint = diffrax.DirectAdjoint()

        def cost(factor):
            solver = cg.jax.Solver("CF3", dense="steps")
            run = solve(ours, solver, y0, h=0.25, args=factor, max_steps=4, adjoint=adjoint)
            return jnp.abs(run.ys[-1].reshape(-1)[0] - 0.3) ** 2

        values = jax.jit(lambda x: (cost(x), jax.grad(cost)(x), jax.hessian(cost)(x)))
        _, slope, curvature = values(0.8)
        by_values = self.quotient(lambda s: float(values(0.8 + s)[0]), 0.05)
        by_slopes = self.quotient(lambda s: float(values(0.8 + s)[1]), 0.05)
        assert float(slope) == pytest.approx(by_values, abs=1e-6)
        assert float(curvature) == pytest.approx(by_slopes, abs=1e-5)

    def test_gradients_through_solve_ivp_are_found_here(self):
        def end(inertia):
            f = body(jnp)
            return cg.solve_ivp(
                lambda t, y: f(t, y, inertia), (0.0, 1.0), START, frame=ATTITUDE_AND_VELOCITY
            ).y[-1, 0]

        def listed(inertia):
            f = body(jnp)
            return cg.solve_ivp(
                lambda t, y: list(f(t, y, inertia)), (0.0, 1.0), START, frame=ATTITUDE_AND_VELOCITY
            ).y[-1, 0]

        def from_start(y0):
            return cg.solve_ivp(body(np), (0.0, 1.0), y0, frame=ATTITUDE_AND_VELOCITY).y[-1, 0]

        for function, at in ((end, INERTIA), (listed, INERTIA), (from_start, START)):
            with pytest.raises(ValueError, match=r"cg\.jax has the methods for JAX"):
                jax.grad(function)(jnp.asarray(at))
            with pytest.raises(ValueError, match=r"cg\.jax has the methods for JAX"):
                jax.jit(function)(jnp.asarray(at))


class TestRefusals:
    def ours(self):
        return term(UnitQuaternion())[0]

    def test_methods(self):
        with pytest.raises(ValueError, match="method must be the name of a method"):
            cg.jax.Solver("CF99")
        with pytest.raises(ValueError, match="method must be explicit in JAX, got"):
            cg.jax.Solver("DICG3")
        with pytest.raises(ValueError, match='dense must be "accurate" or "steps", got 1'):
            cg.jax.Solver("CF4", dense=1)
        with pytest.raises(ValueError, match="solver must be a pair for steps to be chosen"):
            solve(self.ours(), cg.jax.Solver("CF4"), point(UnitQuaternion()))

    def test_terms(self):
        y0 = point(UnitQuaternion())
        ode = diffrax.ODETerm(lambda t, y, args: y)
        with pytest.raises(TypeError, match=r"terms must be one cg.jax.FrameTerm, got ODETerm"):
            diffrax.diffeqsolve(ode, cg.jax.Solver("CF4"), 0.0, 1.0, 0.1, y0)
        both = diffrax.MultiTerm(self.ours(), self.ours())
        with pytest.raises(TypeError, match="got MultiTerm; f is one function"):
            diffrax.diffeqsolve(both, cg.jax.Solver("CF4"), 0.0, 1.0, 0.1, y0, 1.0)
        with pytest.raises(TypeError, match="f must be a function, got 3"):
            cg.jax.FrameTerm(3, UnitQuaternion())

    def test_right_hand_sides_and_points(self):
        frame = UnitQuaternion()
        y0 = point(frame)

        def run(f=None, y0=y0):
            return solve(term(frame, f)[0], cg.jax.Solver("CF4"), y0, h=0.1)

        wanted = r"f must return 3 real numbers, shape \(3,\), got "
        with pytest.raises(ValueError, match=wanted + r"shape \(4,\)"):
            run(lambda t, y, args: y)
        with pytest.raises(ValueError, match=wanted + "complex128"):
            run(lambda t, y, args: 1j * y[:3])
        with pytest.raises(ValueError, match=wanted + "None"):
            run(lambda t, y, args: None)
        with pytest.raises(ValueError, match=r"y0 must have shape \(4,\), got \(3,\)"):
            run(y0=y0[:3])
        with pytest.raises(ValueError, match="y0 must be real for UnitQuaternion"):
            run(y0=y0 + 0j)

    def test_adjoints(self):
        def cost(y0):
            return solve(
                self.ours(), cg.jax.Solver("CF4"), y0, h=0.1, adjoint=diffrax.BacksolveAdjoint()
            ).ys[-1, 0]

        with pytest.raises(NotImplementedError, match="must not be BacksolveAdjoint"):
            jax.grad(cost)(jnp.asarray(point(UnitQuaternion())))

    def test_controllers(self):
        frame = UnitQuaternion()
        with pytest.raises(ValueError, match=r"atol must be a number or have shape \(3,\)"):
            cg.jax.controller(frame, 1e-6, np.ones(4))
        with pytest.raises(ValueError, match="must not be negative, nor both be zero"):
            cg.jax.controller(frame, 0.0, 0.0)
        with pytest.raises(ValueError, match="rtol and atol must be numbers, got rtol = 'a'"):
            cg.jax.controller(frame, "a", 0.0)
        with pytest.raises(ValueError, match="max_step must be positive, got 0"):
            cg.jax.controller(frame, 1e-6, 1e-6, max_step=0)
