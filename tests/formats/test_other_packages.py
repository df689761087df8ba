"""Methods in JAX, diffrax and nodepy, where these are installed."""

import importlib
import warnings

import numpy as np
import pytest

import cg
from cg.formats import to_diffrax, to_nodepy

pytestmark = pytest.mark.no_core


def module(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError:
            pytest.skip(f"{name} isn't installed")


@pytest.fixture
def jax():
    jax = module("jax")
    jax.config.update("jax_enable_x64", True)
    return jax


def exported(name):
    names = {}
    exec(cg.export(name, "jax"), names)
    return names


def rotation(jax):
    """Return the flow of SO(3) in body axes, whose derivative at zero is right too."""
    np = jax.numpy

    def flow(v, y):
        square = v @ v
        safe = np.where(square > 0.0, square, 1.0)
        angle = np.sqrt(safe)
        s = np.where(square > 0.0, np.sin(angle) / angle, 1.0)
        c = np.where(square > 0.0, (1.0 - np.cos(angle)) / safe, 0.5)
        hat = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
        return y @ (np.eye(3) + s * hat + c * hat @ hat)

    return flow


def field(xp):
    return lambda t, y, k=1.0: xp.stack([k * y[0, 1] + t, y[1, 2] - 0.5 * k, y[2, 0] * t + k])


@pytest.mark.slow  # compiling, where JAX is
class TestJax:
    @pytest.mark.parametrize("name", ["CG3", "CG5d", "CF4", "CF6c", "CG2(3)"])
    def test_steps_equal_integrate(self, jax, name):
        step, flow = exported(name)["step"], rotation(jax)

        def trajectory(y):
            body = lambda k, y: step(field(jax.numpy), flow, k * 0.1, y, 0.1)  # noqa: E731
            return jax.lax.fori_loop(0, 10, body, y)

        ours = cg.integrate(field(np), (0, 1), np.eye(3), frame=cg.frames.SO3(), method=name, h=0.1)
        found = jax.jit(trajectory)(jax.numpy.eye(3))
        np.testing.assert_allclose(found, ours.y[-1], rtol=0, atol=2e-14)

    def test_gradients(self, jax):
        step, flow = exported("CF4")["step"], rotation(jax)

        def last(k):
            f = field(jax.numpy)
            return step(lambda t, y: f(t, y, k), flow, 0.0, jax.numpy.eye(3), 0.5)[0, 1]

        e = 1e-5
        difference = float(last(0.7 + e) - last(0.7 - e)) / (2 * e)
        assert float(jax.grad(last)(0.7)) == pytest.approx(difference, rel=1e-8)
        assert abs(difference) > 0.1

    def test_batches(self, jax):
        step, flow = exported("CG4a")["step"], rotation(jax)
        frame = cg.frames.SO3()
        start = frame.random_point(np.random.default_rng(3), 7)
        many = jax.vmap(lambda y: step(field(jax.numpy), flow, 0.0, y, 0.3))(start)
        for y, moved in zip(start, many, strict=True):
            ours = cg.integrate(field(np), (0, 0.3), y, frame=frame, method="CG4a", h=0.3)
            np.testing.assert_allclose(moved, ours.y[-1], atol=1e-14)

    def test_errors_and_algebras(self, jax):
        xp = jax.numpy
        flow = lambda v, y: y + v  # noqa: E731
        f = lambda t, y: xp.array([y[1], -y[0] + t])  # noqa: E731
        y = xp.array([0.3, 0.4])
        dexpinv = lambda u, v: v  # noqa: E731
        point, errors = exported("RKMK8(5,3)")["step_error"](f, flow, dexpinv, 0.0, y, 0.1)
        assert errors.shape == (2, 2)
        assert 0 < abs(errors).max() < 1e-5
        ours = cg.integrate(
            lambda t, y: [y[1], -y[0] + t], (0, 0.1), y, frame=cg.frames.Euclidean(2),
            method="RKMK8(5,3)", h=0.1,
        )  # fmt: skip
        np.testing.assert_allclose(point, ours.y[-1], atol=1e-15)


def oscillator(t, y):
    return np.array([y[1], -np.sin(y[0]) + 0.1 * t])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["CG3", "CG5d", "DP5(4)", "CG2(3)", "RKMK8(5,3)", "CF6c"])
def test_diffrax(jax, name):
    diffrax = module("diffrax")
    method = cg.catalogue.resolve_method(name)
    made = to_diffrax(name)

    class Solver(diffrax.AbstractERK):
        tableau = made
        interpolation_cls = diffrax.ThirdOrderHermitePolynomialInterpolation.from_k

        def order(self, terms):
            return method.order

    xp = jax.numpy
    term = diffrax.ODETerm(lambda t, y, _: xp.array([y[1], -xp.sin(y[0]) + 0.1 * t]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = diffrax.diffeqsolve(term, Solver(), 0.0, 1.0, 0.125, xp.array([0.3, 0.4]))
    ours = cg.integrate(
        oscillator, (0, 1), [0.3, 0.4], frame=cg.frames.Euclidean(2), method=name, h=0.125
    )
    np.testing.assert_allclose(found.ys[-1], ours.y[-1], rtol=0, atol=1e-14)
    assert (abs(made.b_error).max() > 0) == (method.embedded_order is not None)


@pytest.mark.parametrize("name", ["CG3", "CG2(3)", "CG4(3)b", "CF4", "DP5(4)", "CG5d"])
def test_nodepy(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        module("nodepy")
        found = to_nodepy(name)
        method = cg.catalogue.resolve_method(name)
        better = max(method.order, method.embedded_order or 0)
        assert found.order() == better
        np.testing.assert_array_equal(found.A.astype(float), method.a)
        np.testing.assert_allclose(found.c.astype(float), method.c, atol=1e-15)
        if method.embedded_order is not None:
            assert found.embedded_method.order() == min(method.order, method.embedded_order)


def test_rejects():
    for convert in (to_diffrax, to_nodepy):
        with pytest.raises(ValueError, match=r"method must be explicit, got <Tableau DICG4: .*"):
            convert("DICG4")
        with pytest.raises(TypeError, match="method must be a name or a Method, got 3"):
            convert(3)
    with pytest.raises(ValueError, match="method must have two stages or more for diffrax"):
        to_diffrax("LieEuler")
