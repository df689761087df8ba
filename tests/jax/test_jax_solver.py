"""Steps, errors and output in JAX equal those of compiled code."""

import pickle
from itertools import product

import numpy as np
import pytest
from jax_problems import ATTITUDE_AND_VELOCITY, INERTIA, START, body, point, solve, squeeze, term
from jax_setup import diffrax, jax
from kinds import FROZEN, MUNTHE_KAAS
from python_steps import Step
from slow_cases import slow

import cg
from cg import frames as fr
from cg.jax.solver import SolverState

eqx = pytest.importorskip("equinox")
jnp = jax.numpy
METHODS = {**FROZEN, **MUNTHE_KAAS}
EXPLICIT = [name for name, method in METHODS.items() if method.explicit]
# a tableau, points, last stages that are the next first, errors of two and three results
KINDS = [
    "LieEuler", "CG4a", "CG2(3)", "CF4", "CF5r", "CF5(4)", "CF6(5)", "DP5(4)", "DOP853", "RKMK4",
    "RKMK5(4)", "RKMK8(5,3)",
]  # fmt: skip

FRAMES = [
    fr.SE3(), fr.Sphere(2), fr.Stiefel(3, 2), fr.Product(fr.SU(2), fr.Euclidean(2)),
    fr.Hyperbolic(2), fr.Grassmann(3, 1), fr.IsospectralOrbit((-1.0, 1.0), hermitian=True),
]  # fmt: skip
OTHERS = [
    fr.SO3("space"), fr.SU(3), fr.Power(fr.Sphere(2), 2), fr.Semidirect(fr.SO3(), 2), fr.SO(4),
    fr.SO(2), fr.U(2), fr.SPD(2), fr.SL(2), fr.Sp(2, "body"),
    fr.IsospectralOrbit((0.0, 0.0, 1.0)), fr.Product(fr.Stiefel(3, 2), fr.SO3()),
    fr.Product(fr.SPD(2), fr.Sphere(2)),
]  # fmt: skip

pytestmark = pytest.mark.filterwarnings("ignore:Complex dtype support in Diffrax")


class TestSteps:
    @pytest.mark.parametrize("name", [*KINDS, *slow(*(n for n in EXPLICIT if n not in KINDS))])
    def test_all_methods(self, name):
        frame = fr.UnitQuaternion()
        ours, f = term(frame)
        solver = cg.jax.Solver(name)
        y0, h = point(frame), 0.1
        y = jnp.asarray(y0)
        state = solver.init(ours, 0.0, h, y, 1.0)
        for k in range(2):
            y, _, _, state, _ = solver.step(ours, k * h, (k + 1) * h, y, 1.0, state, False)
        expected = cg.integrate(f, (0.0, 2 * h), y0, frame=frame, method=name, h=h).y[-1]
        np.testing.assert_allclose(y, expected, rtol=0.0, atol=1e-14)

    @pytest.mark.parametrize(("frame", "name"), [
        *product([*FRAMES, squeeze()], ["CF4(3)"]), *slow((fr.SPD(2), "CG4(3)")),
        *slow(*product(OTHERS, ["CF4(3)"]), *product([*FRAMES, *OTHERS], ["RKMK5(4)"])),
    ], ids=repr)  # fmt: skip
    def test_all_frames_between_steps_too(self, frame, name):
        ours, f = term(frame)
        y0 = np.diag([1.0, 1e-3]) if name == "CG4(3)" else point(frame)  # near singular
        h, inner = 0.1, np.array([0.0, 0.3, 0.8, 1.0])
        solver = cg.jax.Solver(name)

        @jax.jit  # compiles in a fraction of the time of diffeqsolve
        def step(t, y, state):
            y1, _, dense, state, _ = solver.step(ours, t, t + h, y, 1.0, state, False)
            within = solver.interpolation_cls(t0=t, t1=t + h, **dense)
            return y1, state, jax.vmap(within.evaluate)(t + h * inner)

        y = jnp.asarray(y0)
        state = solver.init(ours, 0.0, h, y, 1.0)
        for k in range(2):
            y, state, points = step(k * h, y, state)
            ts = (k + inner) * h
            expected = cg.solve_ivp(f, (0.0, 2 * h), y0, frame=frame, method=name, h=h, t_eval=ts)
            np.testing.assert_allclose(points, expected.y, rtol=0.0, atol=1e-14)


class TestErrors:
    @pytest.mark.parametrize(("frame", "name", "rtol"), [
        (ATTITUDE_AND_VELOCITY, "RKMK8(5,3)", 1e-9),
        (ATTITUDE_AND_VELOCITY, "CF5(4)", 1e-4),
        (fr.Stiefel(3, 2), "CF4(3)", 1e-6),
        *slow(
            (ATTITUDE_AND_VELOCITY, "CG4(3)", 1e-6), (fr.Stiefel(3, 2), "RKMK8(5,3)", 1e-6),
            (fr.Sphere(2), "RKMK8(5,3)", 1e-4), (fr.SE3(), "CF6(5)", 1e-6),
            (fr.SU(2), "CF5(4)", 1e-9), (fr.Product(fr.SU(2), fr.Euclidean(2)), "CG4(3)", 1e-6),
        ),
    ])  # fmt: skip
    def test_steps_are_those_of_solve_ivp(self, frame, name, rtol):
        ours, f = term(frame)
        y0 = point(frame)
        solution = solve(ours, cg.jax.Solver(name), y0, end=2.0, rtol=rtol)
        expected = cg.solve_ivp(f, (0.0, 2.0), y0, frame=frame, method=name, rtol=rtol, atol=rtol)
        assert solution.stats["num_accepted_steps"] == len(expected.t) - 1
        np.testing.assert_allclose(solution.ys[-1], expected.y[-1], rtol=0.0, atol=1e-12)

    def test_controllers_of_diffrax_and_steps_backwards(self):
        """``PIDController`` measures errors in entries of points."""
        frame = ATTITUDE_AND_VELOCITY
        ours, solver = cg.jax.FrameTerm(body(jnp), frame), cg.jax.Solver("CF5(4)")
        pid = diffrax.PIDController(rtol=1e-8, atol=1e-8)
        end = solve(ours, solver, START, end=2.0, h=0.01, stepsize_controller=pid, args=INERTIA)
        exact = cg.solve_ivp(body(np), (0.0, 2.0), START, frame=frame, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(end.ys[-1], exact.y[-1], rtol=0.0, atol=1e-7)
        back = diffrax.diffeqsolve(
            ours, solver, 2.0, 0.0, None, jnp.asarray(exact.y[-1]), INERTIA,
            stepsize_controller=cg.jax.controller(frame, 1e-9, 1e-9),
        )  # fmt: skip
        np.testing.assert_allclose(back.ys[-1], START, rtol=0.0, atol=1e-9)

    @pytest.mark.parametrize("name", ["DOP853", "RKMK8(5,3)"])
    def test_estimates_of_kinks(self, name):
        """At a time at which the difference of the results vanishes."""
        kink = 0.46525

        f = lambda t, y, args=None: abs(t - kink) * np.ones(1)
        solver, y0 = cg.jax.Solver(name), np.zeros(1)
        ours = cg.jax.FrameTerm(f, fr.Euclidean(1))
        start = SolverState(kink * y0 + kink, None, has_events=False, between=False)
        _, error, *_ = solver.step(ours, 0.0, 1.0, jnp.asarray(y0), None, start, False)
        _, expected = Step(f, fr.Euclidean(1), METHODS[name]).trial(0.0, y0, 1.0, 0.0, 1.0)
        assert abs(error[0]) == pytest.approx(expected, abs=1e-14)
        assert expected > 1e-4

    def test_rejected_steps_are_those_of_solve_ivp(self):
        """Steps that lead to a sudden motion are rejected; after a rejection they don't grow."""
        frame = fr.Euclidean(1)

        f = lambda xp, t: xp.where(t < 1.0, 0.0, xp.cos(50.0 * t)).reshape(1)
        ours = cg.jax.FrameTerm(lambda t, y, args: f(jnp, t), frame)
        solution = solve(
            ours, cg.jax.Solver("CF4(3)"), np.zeros(1), end=2.0, rtol=1e-6,
            saveat=diffrax.SaveAt(steps=True),
        )  # fmt: skip
        expected = cg.solve_ivp(
            lambda t, y: f(np, t), (0.0, 2.0), [0.0], frame=frame, method="CF4(3)",
            rtol=1e-6, atol=1e-6,
        )  # fmt: skip
        ts = solution.ts[np.isfinite(solution.ts)]
        assert solution.stats["num_rejected_steps"] == expected.nrejected > 3
        assert len(ts) == expected.steps
        # later, differences by rounding have grown
        np.testing.assert_allclose(ts[:32], expected.t[1:33], rtol=1e-9)

    def test_a_jump_of_f_between_steps(self):
        """The first stage after it is evaluated again, also of methods that keep the last one."""
        frame = fr.Euclidean(1)
        ours = cg.jax.FrameTerm(lambda t, y, args: jnp.where(t < 0.5, 1.0, -3.0)[None], frame)
        loose = cg.jax.controller(frame, 1e3, 1e3)
        steps = diffrax.ClipStepSizeController(loose, jump_ts=[0.5])
        for name in ("DP5(4)", "RKMK5(4)"):
            solver = cg.jax.Solver(name)
            end = solve(ours, solver, np.zeros(1), h=0.25, stepsize_controller=steps).ys[-1, 0]
            assert float(end) == pytest.approx(-1.0, abs=1e-14)

    def test_the_largest_step(self):
        frame = fr.Euclidean(1)
        ours = cg.jax.FrameTerm(lambda t, y, args: 0.0 * y + 1.0, frame)
        steps = cg.jax.controller(frame, 1e-3, 1e-3, max_step=0.125)
        for first in (None, 0.5):
            solution = solve(
                ours, cg.jax.Solver("BS3(2)"), np.zeros(1), h=first, max_steps=16,
                stepsize_controller=steps, saveat=diffrax.SaveAt(steps=True),
            )  # fmt: skip
            count = int(solution.stats["num_steps"])
            assert np.diff(solution.ts[:count], prepend=0.0).max() < 0.125 + 1e-15
            assert float(solution.ys[count - 1, 0]) == pytest.approx(1.0, abs=1e-15)


class TestOutput:
    def test_output_at_steps_of_functions_and_dense(self):
        frame = fr.UnitQuaternion()
        ours, f = term(frame)
        y0, ts = point(frame), np.array([0.05, 0.37])
        parts = [
            diffrax.SubSaveAt(t0=True, steps=True),
            diffrax.SubSaveAt(ts=ts, fn=lambda t, y, args: y[0]),
        ]
        options = {"h": 0.1, "end": 0.4, "max_steps": 8}
        saveat = diffrax.SaveAt(subs=parts, dense=True)
        solution = solve(ours, cg.jax.Solver("CF3"), y0, **options, saveat=saveat)
        expected = cg.solve_ivp(
            f, (0.0, 0.4), y0, frame=frame, method="CF3", h=0.1, dense_output=True
        )
        for actual, exact in (
            (solution.ys[0][:5], expected.y),
            (solution.ys[1], expected.sol(ts)[:, 0]),
            (solution.evaluate(0.37), expected.sol(0.37)),
        ):
            np.testing.assert_allclose(actual, exact, rtol=0.0, atol=1e-14)


TURNING = [fr.SO3(), fr.SO(4), fr.IsospectralOrbit((-1.0, 1.0), hermitian=True)]
OTHER_TURNING = [
    fr.SU(2), fr.UnitQuaternion(), fr.Sphere(2), fr.Power(fr.Sphere(2), 3), fr.Grassmann(3, 1),
    fr.Product(fr.Euclidean(1), fr.SO3()),
]  # fmt: skip


@pytest.mark.parametrize(("frame", "name"), [
    *product(TURNING, ["CF5(4)"]), (fr.Product(fr.Euclidean(1), fr.SO3()), "RKMK5(4)"),
    *slow(*product(TURNING, ["RKMK5(4)"]), *product(OTHER_TURNING, ["CF5(4)", "RKMK5(4)"])),
], ids=repr)  # fmt: skip
def test_estimates_of_long_turns_are_not_believed(frame, name):
    """Beyond 20 radians the error is no less than the change of the coefficients."""
    rng = np.random.default_rng(2)
    axis, change = rng.standard_normal((2, frame.dim))
    axis /= np.sqrt(sum(axis[-3:] ** 2))
    solver, y0 = cg.jax.Solver(name), jnp.asarray(point(frame))

    def error(angle, factor):
        f = cg.jax.FrameTerm(lambda t, y, s: angle * axis + s * (t > 0.0) * change, frame)
        start = SolverState(jnp.asarray(angle * axis), None, has_events=False, between=False)
        return solver.step(f, 0.0, 1.0, y0, factor, start, False)

    error = jax.jit(error)
    for angle in (50.0, 100.0):
        y1, estimate, *_ = error(angle, 1e-2)
        if np.isfinite(y1).all():  # dexpinv doesn't exist beyond a turn
            assert np.linalg.norm(estimate) >= 0.9 * np.linalg.norm(frame.field(1e-2 * change, y1))
    y1, estimate, *_ = error(100.0, 0.0)  # constant coefficients may turn by any angle
    assert np.linalg.norm(estimate) < 2e-12


def test_stored_solvers_are_equal():
    solver = cg.jax.Solver("CF4")
    ours, _ = term(fr.Hyperbolic(2))
    traced = []

    @eqx.filter_jit
    def end(solver):
        traced.append(solver)
        return solve(ours, solver, point(fr.Hyperbolic(2)), h=0.5).ys

    np.testing.assert_array_equal(end(solver), end(pickle.loads(pickle.dumps(solver))))
    assert len(traced) == 1
