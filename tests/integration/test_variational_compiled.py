"""Derivatives of solutions with compiled functions against those with Python functions."""

import ctypes

import numpy as np
import pytest
from compiled_examples import DOUBLES

import cg
from cg.frames import SO3, Euclidean, Product, Stiefel

BODY = Product(SO3(), Euclidean(3))
Y0 = BODY.join(SO3().flow([0.3, 0.2, 0.1], np.eye(3)), np.array([0.3, 0.2, 1.0]))
P = np.array([0.8, 0.9, 0.4, 2.0])
SPAN = (0.0, 2.0)
GIVEN = {"frame": BODY, "rtol": 1e-10, "atol": 1e-10}


def top(t, y, p):
    attitude, m = BODY.split(y)
    w = m / p[:3]
    return np.concatenate(
        [w, np.cross(m, w) + p[3] * np.array([attitude[2, 1], -attitude[2, 0], 0])]
    )


@pytest.fixture
def functions(compiled_function):
    return {
        "f": compiled_function("top"),
        "jac": compiled_function("top_jac"),
        "df_dp": compiled_function("top_df_dp"),
    }


def solve(functions, **options):
    arguments = {"t_span": SPAN, "y0": Y0, "parameters": P, **GIVEN, **functions, **options}
    return cg.solve_variational(**arguments)


def agree(actual, expected, tolerance):
    size = np.abs(expected.transition).max()
    for name in ("y", "transition", "sensitivity"):
        np.testing.assert_allclose(
            getattr(actual, name)[-1], getattr(expected, name)[-1], rtol=0, atol=tolerance * size
        )


def test_all_of_it_is_called_by_compiled_code(functions, monkeypatch):
    expected = solve({"f": top})
    monkeypatch.setattr(
        "cg.integration.derivatives.variational_equation.VariationalEquation.__call__",
        lambda *arguments: pytest.fail("Python was asked"),
    )
    agree(solve({"f": top}), expected, 1e-12)
    agree(solve(functions), expected, 1e-9)
    agree(solve({"f": functions["f"]}), expected, 1e-9)
    agree(solve(functions | {"jac": None}), expected, 1e-9)
    agree(solve(functions | {"df_dp": None}), expected, 1e-9)


@ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, DOUBLES, DOUBLES, ctypes.c_void_p)
def grows(t, y, f, data):
    """The tangent of y/2 grows by the exponential of the integral of the input."""
    f[0] = ctypes.cast(data, DOUBLES)[0] * np.sin(y[0])
    return 0


@pytest.mark.parametrize(("span", "growth"), [((0.0, 2.5), np.e), ((2.5, 0.0), 1 / np.e)])
def test_inputs_without_parameters(span, growth):
    held = cg.Samples([0.0, 1.0, 2.0], [1.0, -2.0, 4.0])
    y0 = np.array([[0.4], [-0.2]])
    y = 2.0 * np.arctan(growth * np.tan(y0 / 2.0))
    slope = np.sin(y) / np.sin(y0)
    options = {"frame": Euclidean(1), "inputs": held, "method": "CF5(4)", "rtol": 1e-10}
    options |= {"atol": 1e-10}
    forward = cg.solve_variational_ensemble(grows, span, y0, control_derivatives=True, **options)
    np.testing.assert_allclose(forward.transition[-1, :, 0], slope, rtol=0, atol=1e-9)
    assert forward.sensitivity is None
    for k in range(2):
        alone = cg.solve_variational(grows, span, y0[k], control_derivatives=True, **options)
        np.testing.assert_array_equal(alone.transition[-1], forward.transition[-1, k])
        adjoint = cg.solve_variational(grows, span, y0[k], derivatives="adjoint", **options)
        by_y0, by_parameters, by_values = adjoint.gradient([1.0])
        np.testing.assert_allclose(by_y0, slope[k], rtol=0, atol=2e-9)
        held_for = np.copysign([1.0, 1.0, 0.5], span[1] - span[0])
        np.testing.assert_allclose(by_values, held_for * np.sin(y[k]), rtol=0, atol=2e-9)
        assert by_parameters is None
    many = held, cg.Samples([0.0], np.ones((1, 10_000)))  # there must be room for all of them
    wide = cg.solve_variational(grows, span, y0[0], **options | {"inputs": many})
    np.testing.assert_allclose(wide.transition[-1, :, 0], slope[0], rtol=0, atol=1e-8)
    alone = cg.solve_ivp(grows, span, y0[0], **options | {"inputs": many})
    np.testing.assert_allclose(alone.y[-1], y[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("way", [{}, {"control_derivatives": True}, {"derivatives": "adjoint"}])
@pytest.mark.parametrize("frame", [SO3(), Stiefel(3, 2)], ids=["compiled", "in Python"])
@pytest.mark.parametrize("inputs", [None, cg.Samples([0.0, 0.5], [[1.0], [2.0]])])
def test_f_may_keep_what_it_gets(way, frame, inputs):
    """Differences by parameters don't change them in arrays that f has kept."""
    kept = []

    def f(t, y, *rest):
        given = y, *rest
        kept.extend((each, np.array(each)) for each in given)
        assert not any(each.flags.writeable for each in (y, rest[-1]))
        return [np.sin(t * rest[0][0]), rest[-1][0] ** 2, y[0, 1]]

    y0 = frame.random_point(np.random.default_rng(4))
    given = {"frame": frame, "inputs": inputs, "parameters": [0.3], **way}
    run = cg.solve_variational(f, (0, 1), y0, **given)
    if way.get("derivatives"):
        run.gradient(np.ones(3))
    for now, then in kept:
        np.testing.assert_array_equal(now, then)


class TestFailures:
    @pytest.mark.parametrize("name", ["f", "jac", "df_dp"])
    @pytest.mark.parametrize(("wrong", "error", "message"), [
        ("stops", RuntimeError, "returned the error code 7 at t ="),
        ("writes_nothing", ValueError, "must return finite numbers"),
    ])  # fmt: skip
    def test_the_function_is_named(self, functions, compiled_function, name, wrong, error, message):
        with pytest.raises(error, match=f"^{name} {message}"):
            solve(
                functions | {name: compiled_function(wrong)}, y0=BODY.join(np.eye(3), np.zeros(3))
            )

    @pytest.mark.parametrize("name", ["jac", "df_dp"])
    def test_signatures(self, compiled_library, functions, name):
        other = compiled_library["top_jac"]
        other.restype, other.argtypes = ctypes.c_double, [ctypes.c_double]
        with pytest.raises(ValueError, match=f"^{name} must have the signature 'int"):
            solve(functions | {name: other})
