"""Export to diffrax and nodepy, if these are installed."""

import importlib
import warnings

import numpy as np
import pytest

import cg
from cg.construction.formats import to_diffrax, to_nodepy


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


def oscillator(t, y):
    return np.array([y[1], -np.sin(y[0]) + 0.1 * t])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["CG3", "CG5d", "DP5(4)", "CG2(3)", "RKMK8(5,3)", "CF6c"])
def test_diffrax(jax, name):
    diffrax = module("diffrax")
    method = cg.construction.catalogue.resolve_method(name)
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
        solution = diffrax.diffeqsolve(term, Solver(), 0.0, 1.0, 0.125, xp.array([0.3, 0.4]))
    ours = cg.integrate(
        oscillator, (0, 1), [0.3, 0.4], frame=cg.frames.Euclidean(2), method=name, h=0.125
    )
    np.testing.assert_allclose(solution.ys[-1], ours.y[-1], rtol=0, atol=1e-14)
    assert (abs(made.b_error).max() > 0) == (method.embedded_order is not None)


@pytest.mark.parametrize("name", ["CG3", "CG2(3)", "CG4(3)b", "CF4", "DP5(4)", "CG5d"])
def test_nodepy(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        module("nodepy")
        actual = to_nodepy(name)
        method = cg.construction.catalogue.resolve_method(name)
        better = max(method.order, method.embedded_order or 0)
        assert actual.order() == better
        np.testing.assert_array_equal(actual.A.astype(float), method.a)
        np.testing.assert_allclose(actual.c.astype(float), method.c, atol=1e-15)
        if method.embedded_order is not None:
            assert actual.embedded_method.order() == min(method.order, method.embedded_order)
