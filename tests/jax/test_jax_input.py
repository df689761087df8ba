"""Wrong points, functions, tolerances, methods and combinations with diffrax in JAX."""

import numpy as np
import pytest
from jax_problems import ATTITUDE_AND_VELOCITY, point, solve, squeeze, term
from jax_setup import diffrax, jax
from refusals import refuses

import cg
from cg import frames as fr

jnp = jax.numpy
eqx = pytest.importorskip("equinox")

pytestmark = pytest.mark.filterwarnings("ignore:Complex dtype support in Diffrax")


def test_points_off_the_manifold():
    frame = fr.SO3()

    end = lambda y0: solve(term(frame)[0], cg.jax.Solver("CF3"), y0, h=0.5).ys[-1]
    for wrong in (
        2.0 * jnp.eye(3),
        jnp.eye(3).at[0, 1].set(1e-7),
        jnp.eye(3).at[0, 1].set(jnp.nan),
    ):
        refuses(RuntimeError, "y0 must", lambda y: jax.block_until_ready(jax.jit(end)(y)), wrong)
    assert np.isfinite(jax.jit(end)(jnp.eye(3).at[0, 1].set(1e-9))).all()


def test_functions_of_numpy():
    f = lambda t, y, args: np.array([np.sin(t), 0.0, 0.0])
    with pytest.raises(jax.errors.TracerArrayConversionError) as error:
        solve(cg.jax.FrameTerm(f, fr.SO3()), cg.jax.Solver("CF4"), jnp.eye(3), h=0.1)
    assert "f must be written in jax.numpy" in error.value.__notes__[0]


def test_tolerances_below_rounding():
    frame = fr.SO3()
    with pytest.warns(UserWarning, match="too small to be attained in float64, whose spacing is"):
        cg.jax.controller(frame, 1e-16, 1e-16)
    with jax.enable_x64(False):
        with pytest.warns(UserWarning, match="in float32.*set jax_enable_x64"):
            cg.jax.controller(frame, 1e-12, 1e-12)
        cg.jax.controller(frame, 1e-5, 1e-6)


class TestRefusals:
    def ours(self):
        return term(fr.UnitQuaternion())[0]

    def test_methods(self):
        refuses(ValueError, "method must", cg.jax.Solver, "CF99")
        refuses(ValueError, "method must", cg.jax.Solver, "DICG3")
        refuses(TypeError, "unroll must", cg.jax.Solver, "RKMK4", unroll=2)
        with pytest.raises(ValueError, match="which needs brackets"):
            solve(term(squeeze())[0], cg.jax.Solver("RKMK4"), np.ones(3), h=0.1)
        with pytest.raises(ValueError, match="solver must"):
            solve(self.ours(), cg.jax.Solver("CF4"), point(fr.UnitQuaternion()))

    def test_terms(self):
        y0 = point(fr.UnitQuaternion())
        ode = diffrax.ODETerm(lambda t, y, args: y)
        with pytest.raises(TypeError, match="terms must"):
            diffrax.diffeqsolve(ode, cg.jax.Solver("CF4"), 0.0, 1.0, 0.1, y0)
        both = diffrax.MultiTerm(self.ours(), self.ours())
        with pytest.raises(TypeError, match="f is one function"):
            diffrax.diffeqsolve(both, cg.jax.Solver("CF4"), 0.0, 1.0, 0.1, y0, 1.0)
        refuses(TypeError, "f must", cg.jax.FrameTerm, 3, fr.UnitQuaternion())

    def test_right_hand_sides_and_points(self):
        frame = fr.UnitQuaternion()
        y0 = point(frame)

        run = lambda f=None, y0=y0: solve(term(frame, f)[0], cg.jax.Solver("CF4"), y0, h=0.1)
        expected = r"f must return 3 real numbers, shape \(3,\), got "
        refuses(ValueError, expected + r"shape \(4,\)", run, lambda t, y, args: y)
        refuses(ValueError, expected + "complex128", run, lambda t, y, args: 1j * y[:3])
        refuses(ValueError, expected + "None", run, lambda t, y, args: None)
        refuses(ValueError, "y0 must", run, y0=y0[:3])
        refuses(ValueError, r"got \(2, 4\); jax.vmap takes a batch", run, y0=np.stack([y0, y0]))
        refuses(ValueError, "y0 must", run, y0=y0 + 0j)
        ours, both = term(ATTITUDE_AND_VELOCITY)[0], (y0, np.ones(3))
        with pytest.raises(ValueError, match=r"got a tuple; cg.jax.join makes one of its parts"):
            solve(ours, cg.jax.Solver("CF4"), both, h=0.1)

    @pytest.mark.parametrize("frame", [fr.SO3(), fr.Euclidean(2)], ids=repr)
    def test_implicit_adjoints(self, frame):
        """They are refused on manifolds, and give derivatives of steady states in vector spaces."""

        def end(args):
            ours = cg.jax.FrameTerm(lambda t, y, args: args - y.reshape(-1)[: frame.dim], frame)
            adjoint = diffrax.ImplicitAdjoint()
            y0 = frame.random_point(np.random.default_rng(1))
            solver = cg.jax.Solver("CF4")
            return solve(ours, solver, y0, h=0.5, end=20.0, args=args, adjoint=adjoint).ys[-1]

        if frame == fr.SO3():
            with pytest.raises(NotImplementedError, match="must not be ImplicitAdjoint on a mani"):
                jax.jacobian(end)(jnp.zeros(3))
        else:
            np.testing.assert_allclose(
                jax.jacobian(end)(jnp.ones(2)), np.eye(2), rtol=0, atol=1e-14
            )

    def test_functions_that_are_not_finite(self):
        frame = fr.UnitQuaternion()
        ours = cg.jax.FrameTerm(lambda t, y, good: jnp.where(t > good, jnp.nan, y[:3]), frame)

        @eqx.filter_jit
        def compiled(good, name, **options):
            solver = cg.jax.Solver(name)
            return solve(ours, solver, point(frame), args=good, **options)

        def run(good, name="CF4(3)", **options):
            return jax.block_until_ready(compiled(jnp.asarray(good), name, **options))

        for options in ({}, {"name": "CF4", "h": 0.1}):
            refuses(RuntimeError, r"Nonfinite .* values detected", run, 0.5, **options)
        refuses(RuntimeError, "f must", run, -1.0)
        for good in (0.0, 0.5):
            solution = run(good, throw=False)
            assert solution.result == diffrax.RESULTS.nonfinite
            assert solution.stats["num_steps"] < 100
            assert np.isfinite(solution.ys).all()

    def test_controllers(self):
        frame = fr.UnitQuaternion()
        refuses(ValueError, "atol must", cg.jax.controller, frame, 1e-6, np.ones(4))
        for bad in ((0.0, 0.0), (np.inf, 0.0), (0.0, np.inf), (-1.0, 1.0), (np.nan, 1.0)):
            refuses(ValueError, "be finite, not neg.* not both", cg.jax.controller, frame, *bad)
        refuses(ValueError, "rtol and atol must", cg.jax.controller, frame, "a", 0.0)
        refuses(ValueError, "max_step must", cg.jax.controller, frame, 1e-6, 1e-6, max_step=0)
        refuses(TypeError, "max_step must", cg.jax.controller, frame, 1e-6, 1e-6, max_step="a")
        refuses(TypeError, "max_angle must", cg.jax.Solver, "CF4", max_angle="a")
        other = cg.jax.controller(ATTITUDE_AND_VELOCITY, 1e-6, 1e-6)
        with pytest.raises(ValueError, match="controller must"):
            diffrax.diffeqsolve(
                self.ours(), cg.jax.Solver("CF5(4)"), 0.0, 1.0, None, point(frame), 1.0,
                stepsize_controller=other,
            )  # fmt: skip
