"""Gradients by the adjoint equation with respect to the values of samples."""

import numpy as np
import pytest
from driven_bodies import FRAME, GAIN, GUSTS, LINE, START, driven
from quotients import derivative
from waves import TIGHT

import cg


@pytest.mark.parametrize("kind", ["hold", "linear", "cubic", "averages"])
@pytest.mark.parametrize("in_c", [False, True])
@pytest.mark.parametrize("span", [(0.0, 2.1), (2.0, 0.1)])
def test_gradients_by_values_of_inputs(kind, in_c, span, function):
    rng = np.random.default_rng(7)
    values = rng.standard_normal((8, 3))
    count = 9 if kind == "averages" else 8
    times = np.linspace(0.0, 2.2, count)
    times[1:-1] += rng.uniform(-0.05, 0.05, count - 2)
    f = function("blown") if in_c else driven

    def inputs(values, gusts):
        return cg.Samples(times, values, kind), cg.Samples(GUSTS[0], gusts, "linear")

    options = {"frame": FRAME, "parameters": GAIN}
    run = cg.solve_variational(
        f, span, START, inputs=inputs(values, GUSTS[1]), derivatives="adjoint", rtol=1e-8,
        atol=1e-8, **options,
    )  # fmt: skip
    c = rng.standard_normal(6)
    gradient = run.gradient(c)
    forward = cg.solve_variational(
        f, span, START, inputs=inputs(values, GUSTS[1]), control_derivatives=True, **options,
        **TIGHT,
    )  # fmt: skip
    np.testing.assert_allclose(gradient.y0, c @ forward.transition[-1], rtol=0, atol=4e-9)
    np.testing.assert_allclose(gradient.parameters, c @ forward.sensitivity[-1], rtol=0, atol=4e-9)
    by_torque, by_gust = gradient.inputs
    assert (by_torque.shape, by_gust.shape) == ((8, 3), (11,))
    ways = rng.standard_normal((3, 8, 3)), rng.standard_normal((3, 11))
    for torque, gust in zip(*ways, strict=True):

        def end(s, torque=torque, gust=gust):
            given = inputs(values + s * torque, GUSTS[1] + s * gust)
            y = cg.solve_ivp(f, span, START, inputs=given, **options, **TIGHT).y[-1]
            return c @ FRAME.local_coordinates(forward.y[-1], y)

        actual = np.vdot(by_torque, torque) + np.vdot(by_gust, gust)
        assert abs(actual - derivative(end, bound=1e-9)) < 1e-9


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("kind", ["cubic", "averages"])
def test_gradients_of_random_linear_equations_are_accurate(kind, tolerance):
    for seed in range(8):
        rng = np.random.default_rng([seed, 9])
        g = rng.standard_normal((2, 4, 4)) * rng.uniform(0.3, 3.0)
        frame = cg.frames.LinearAction(list(1j * (g + g.mT) if seed % 2 else g))
        curve = cg.Samples(
            np.linspace(-0.1, 2.1, 12 + (kind == "averages")), rng.standard_normal(12), kind
        )
        y0, c = frame.random_point(rng), frame.random_point(rng)
        exact, actual = (
            cg.solve_linear(
                lambda t, u, p: [p[0] * np.cos(t), u], (0, 2), y0, frame=frame, inputs=curve,
                parameters=[1.3], derivatives="adjoint", rtol=rtol, atol=rtol,
            ).gradient(c)
            for rtol in (1e-13, tolerance)
        )  # fmt: skip
        for one, other in zip(actual, exact, strict=True):
            size = max(1.0, np.abs(other).max())
            np.testing.assert_allclose(one, other, rtol=0, atol=50 * tolerance * size)


def test_steps_pass_knots_that_the_tolerance_cannot_see():
    times = np.linspace(0, 2, 201)
    for kind, values in (("cubic", times), ("averages", 0.5 * (times[1:] + times[:-1]))):
        curve = cg.Samples(times, np.sin(values), kind)
        for rtol, few in ((1e-4, True), (1e-11, False)):
            run = cg.solve_ivp(
                lambda t, y, u: [u], (0, 2), [0.0], frame=LINE, inputs=curve, rtol=rtol, atol=rtol
            )
            assert (run.steps < 20) == few
            assert few or np.isin(times[2:-2], run.t).all()  # splines have no knots beside ends


@pytest.mark.parametrize("df_dp", [None, lambda t, y, u: [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]])
def test_jacobian_by_pulses_that_vanish(df_dp):
    """All amplitudes are equal, so that the curve has no corners; the frame is in Python."""
    frame, times, y0 = cg.frames.Sp(2), np.linspace(0, 1, 11)[:-1], np.eye(2)
    f = lambda t, y, u: [u[0], 1.0, u[1]]
    options = {"frame": frame, "inputs": cg.Samples(times, np.zeros((10, 2)))} | TIGHT
    run = cg.solve_variational(f, (0, 1), y0, derivatives="adjoint", df_dp=df_dp, **options)
    jacobian = run.jacobian()
    np.testing.assert_allclose(jacobian.y0, np.diag(np.exp([-2.0, 0.0, 2.0])), rtol=0, atol=2e-13)
    assert (jacobian.parameters, jacobian.inputs.shape) == (None, (3, 10, 2))
    for way in np.random.default_rng(1).standard_normal((3, 10, 2)):

        def end(s, way=way):
            given = options | {"inputs": cg.Samples(times, s * way)}
            return frame.local_coordinates(run.y[-1], cg.solve_ivp(f, (0, 1), y0, **given).y[-1])

        actual = np.tensordot(jacobian.inputs, way, 2)
        np.testing.assert_allclose(actual, derivative(end, bound=1e-12), rtol=0, atol=1e-12)


@pytest.mark.parametrize("columns", [None, 2])
def test_jacobian_of_complex_entries(columns):
    rng = np.random.default_rng(6)
    g = rng.standard_normal((2, 3, 3)) + 1j * rng.standard_normal((2, 3, 3))
    frame = cg.frames.LinearAction(list(g), columns=columns)
    times, values, y0 = np.linspace(0, 1, 5), rng.standard_normal(5), frame.random_point(rng)

    def solve(values, p, y0, **others):
        curves = cg.Samples(times, values, "cubic"), cg.Samples([0.0], [p])
        return cg.solve_linear(
            lambda t, u, p: [p[0], sum(u)], (0, 1), y0, frame=frame, inputs=curves, parameters=[p],
            **TIGHT, **others,
        )  # fmt: skip

    jacobian = solve(values, 0.4, y0, derivatives="adjoint").jacobian()
    way, to = rng.standard_normal(5), frame.random_point(rng)
    for by_p, by_y0 in ((1.0, 0.0), (0.0, 1.0)):

        def end(s, by_p=by_p, by_y0=by_y0):
            return solve(values + s * way, 0.4 + s * by_p, y0 + s * by_y0 * to).y[-1]

        actual = by_p * (jacobian.parameters[..., 0] + jacobian.inputs[1][..., 0])
        actual = actual + jacobian.inputs[0] @ way
        actual = actual + by_y0 * np.tensordot(jacobian.y0, to, to.ndim)
        np.testing.assert_allclose(actual, derivative(end, bound=3e-9), rtol=0, atol=3e-9)


@pytest.mark.parametrize("size", [-1e-12, -1e-100, 1e-100])
def test_gradients_by_tiny_and_negative_numbers(size):
    """Steps of differences are relative to the sizes of parameters and of values of samples."""
    part = lambda number: np.sin(number / abs(size))
    f = lambda t, y, u, p: (part(u) + part(p[..., 0]))[..., None] * y
    held = cg.Samples([0.0, 0.5, 0.75], size * np.array([1.0, 2.0, 0.0]))
    options = {"frame": cg.frames.Euclidean(1), "inputs": held, "rtol": 1e-9, "atol": 1e-9}
    phases, lengths = np.sign(size) * np.array([1.0, 2.0, 0.0]), np.array([0.5, 0.25, 0.25])
    end = np.exp(np.sin(phases) @ lengths + np.sin(phases[0]))
    by_parameter = end * np.cos(phases[0])
    given = f, (0, 1), [1.0]
    for vectorized in (False, True):
        run = cg.solve_variational_ensemble(
            *given, parameters=[[size]], vectorized=vectorized, **options
        )
        found = run.sensitivity[-1].item() * abs(size)
        np.testing.assert_allclose(found, by_parameter, rtol=1e-9)
    run = cg.solve_variational(*given, parameters=[size], derivatives="adjoint", **options)
    _, by_parameters, by_values = run.gradient([1.0])
    np.testing.assert_allclose(by_parameters * abs(size), [by_parameter], rtol=2e-9)
    expected = lengths * end * np.cos(phases)
    np.testing.assert_allclose(by_values * abs(size), expected, rtol=2e-9)
