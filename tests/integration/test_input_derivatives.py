"""Derivatives of solutions with respect to the values of their inputs."""

import numpy as np
import pytest
from test_inputs import FRAME, GAIN, GUST, GUSTS, HELD, LINE, START, TIGHT, TIMES, TORQUE, driven

import cg


@pytest.mark.parametrize("in_c", [False, True])
@pytest.mark.parametrize("kind", ["hold", "linear"])
@pytest.mark.parametrize("span", [(0.0, 2.2), (2.0, 0.1)])
def test_derivatives_with_respect_to_values(in_c, kind, span, function):
    f = function("blown") if in_c else driven
    options = {"frame": FRAME, "parameters": GAIN, "rtol": 1e-11, "atol": 1e-11}

    def end(values, gusts=GUSTS[1]):
        inputs = cg.Samples(TIMES, values, kind), cg.Samples(GUSTS[0], gusts, "linear")
        return cg.solve_ivp(f, span, START, inputs=inputs, **options).y[-1]

    inputs = cg.Samples(TIMES, TORQUE, kind), GUST
    run = cg.solve_variational(
        f, span, START, inputs=inputs, input_derivatives=True, control_derivatives=True, **options
    )
    without = cg.solve_variational(
        f, span, START, inputs=inputs, control_derivatives=True, **options
    )
    for name in ("y", "transition", "sensitivity"):
        got, expected = getattr(run, name)[-1], getattr(without, name)[-1]
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    assert run.t[0] == span[0]
    assert np.isin([0.3, 0.45, 1.0, 1.4], run.t).all()
    of_torque, of_gust = run.input_sensitivity
    assert of_torque.shape == (6, *TORQUE.shape)
    assert of_gust.shape == (6, 11)
    for k in range(8):
        change, gust = 1e-4 * np.eye(24)[3 * k + k % 3].reshape(8, 3), 1e-4 * np.eye(11)[k]
        for derivative, one, other in (
            (of_torque[:, k, k % 3], end(TORQUE + change), end(TORQUE - change)),
            (of_gust[:, k], end(TORQUE, GUSTS[1] + gust), end(TORQUE, GUSTS[1] - gust)),
        ):
            moved = [FRAME.local_coordinates(run.y[-1], y) for y in (one, other)]
            difference = np.subtract(*moved) / 2e-4
            np.testing.assert_allclose(derivative, difference, rtol=0, atol=1e-7)


def test_derivatives_with_respect_to_pulses_that_vanish():
    """All amplitudes are equal, so that the curve has no corners; the frame is in Python."""
    frame = cg.frames.Sp(2)
    times = np.linspace(0, 1, 11)[:-1]
    pulse = cg.Samples(times, np.zeros((10, 2)))
    f = lambda t, y, u: [u[0], 1.0, u[1]]
    mixed = lambda t, y, u: [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]
    runs = [
        cg.solve_variational(
            f, (0, 1), np.eye(2), frame=frame, inputs=pulse, input_derivatives=True, df_dp=df_dp,
            **TIGHT,
        )
        for df_dp in (None, mixed)
    ]  # fmt: skip
    sensitivity = runs[0].input_sensitivity
    np.testing.assert_allclose(sensitivity, runs[1].input_sensitivity, rtol=0, atol=1e-8)
    assert runs[0].sensitivity is None
    for k in (0, 9):
        change = 1e-5 * np.eye(20)[2 * k].reshape(10, 2)
        ends = [
            cg.solve_ivp(
                f, (0, 1), np.eye(2), frame=frame, inputs=cg.Samples(times, values), **TIGHT
            ).y[-1]
            for values in (change, -change)
        ]
        moved = [frame.local_coordinates(runs[0].y[-1], y) for y in ends]
        difference = np.subtract(*moved) / 2e-5
        np.testing.assert_allclose(sensitivity[:, k, 0], difference, rtol=0, atol=1e-5)


def test_input_derivatives_with_equal_steps_and_without_any():
    f = lambda t, y, u: [u * y[0]]
    held = cg.Samples([0.0, 1.0, 2.0], [0.5, -1.0, 0.25])
    options = {"frame": LINE, "inputs": held, "input_derivatives": True, "method": "CG4a"}
    run = cg.solve_variational(f, (0, 3), [1.0], h=0.02, **options)
    expected = np.exp(-0.25)  # each value acts for one unit of time
    np.testing.assert_allclose(run.input_sensitivity, [[expected] * 3], rtol=1e-7)
    assert run.steps == 150
    nothing = cg.solve_variational(f, (1, 1), [1.0], h=0.02, **options)
    np.testing.assert_array_equal(nothing.input_sensitivity, np.zeros((1, 3)))
    np.testing.assert_array_equal(nothing.t, [1.0])


def test_refused_with_input_derivatives():
    options = {"frame": LINE, "input_derivatives": True}
    f = lambda t, y, u: [u * y[0]]
    with pytest.raises(ValueError, match="inputs must be given with input_derivatives"):
        cg.solve_variational(f, (0, 1), [1.0], **options)
    with pytest.raises(ValueError, match='"hold" or "linear"'):
        cg.solve_variational(
            f, (0, 1), [1.0], inputs=cg.Samples([0, 1], [1, 2], "cubic"), **options
        )
    for name, value in (("events", []), ("t_eval", [0.5]), ("dense_output", True)):
        with pytest.raises(ValueError, match=f"{name} must not be given"):
            cg.solve_variational(f, (0, 1), [1.0], inputs=HELD, **{name: value}, **options)
    failed = cg.solve_variational(
        lambda t, y, u: [u * y[0] ** 2], (0, 1.5), [1.0], inputs=HELD, **options
    )
    assert failed.status == -1
    assert failed.input_sensitivity is None


def test_values_that_start_at_zero_and_pass_through_it():
    times, values = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 1.0, -0.5, 0.0])
    curve = cg.Samples(times, values, kind="linear")
    run = cg.solve_variational(
        lambda t, y, u: [u + u * u], (0, 3), [0.0], frame=LINE, inputs=curve,
        input_derivatives=True, rtol=1e-9, atol=1e-9,
    )  # fmt: skip
    # the integral of each hat function times 1 + 2 u
    mass = np.diag([2.0, 4.0, 4.0, 2.0]) + np.diag(np.ones(3), 1) + np.diag(np.ones(3), -1)
    expected = mass @ (1 + 2 * values) / 6
    np.testing.assert_allclose(run.input_sensitivity[-1].ravel(), expected, rtol=0, atol=1e-6)


def test_differences_by_inputs_near_zero_have_the_scale_of_the_signal():
    """Values that pass a million times smaller ones have no steps that rounding spoils."""
    curve = cg.Samples(np.arange(4.0), [1e-9, 1.0, -1e-9, 0.5])
    run = cg.solve_variational(
        lambda t, y, u: [1.0 + np.sin(u)], (0, 4), [0.0], frame=LINE, inputs=curve,
        input_derivatives=True, rtol=1e-9, atol=1e-9,
    )  # fmt: skip
    np.testing.assert_allclose(run.input_sensitivity[0], np.cos(curve.values), rtol=0, atol=1e-9)


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

    knots = times[(times > 0.1) & (times < 2.0)]  # where curves aren't smooth
    options, tight = {"frame": FRAME, "parameters": GAIN}, {"rtol": 1e-12, "atol": 1e-12}
    options["breakpoints"] = knots[:: 1 if span[1] > span[0] else -1]
    run = cg.solve_variational(
        f, span, START, inputs=inputs(values, GUSTS[1]), derivatives="adjoint", rtol=1e-8,
        atol=1e-8, **options,
    )  # fmt: skip
    c = rng.standard_normal(6)
    gradient = run.gradient(c)
    forward = cg.solve_variational(
        f, span, START, inputs=inputs(values, GUSTS[1]), control_derivatives=True, **options,
        **tight,
    )  # fmt: skip
    np.testing.assert_allclose(gradient.y0, c @ forward.transition[-1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(gradient.parameters, c @ forward.sensitivity[-1], rtol=0, atol=1e-6)
    by_torque, by_gust = gradient.inputs
    assert (by_torque.shape, by_gust.shape) == ((8, 3), (11,))
    ways = rng.standard_normal((3, 8, 3)), rng.standard_normal((3, 11))
    for torque, gust in zip(*ways, strict=True):
        ends = [
            cg.solve_ivp(
                f, span, START, inputs=inputs(values + s * torque, GUSTS[1] + s * gust),
                **options, **tight,
            ).y[-1]
            for s in (1e-5, -1e-5)
        ]  # fmt: skip
        moved = [FRAME.local_coordinates(forward.y[-1], y) for y in ends]
        expected = c @ np.subtract(*moved) / 2e-5
        actual = np.vdot(by_torque, torque) + np.vdot(by_gust, gust)
        assert abs(actual - expected) < 1e-6


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("kind", ["hold", "linear", "cubic", "averages"])
def test_gradients_by_values_of_inputs_of_linear_equations(kind, exact, vectorized):
    rng = np.random.default_rng(3)
    frame = cg.frames.LinearAction([-2j * np.diag([1.0, -1.0]), -1j * np.eye(2)[::-1]])
    times, values = np.linspace(0, 1.5, 8 + (kind == "averages")), rng.standard_normal(8)
    y0, c = frame.random_point(rng), frame.random_point(rng)
    if vectorized:
        a = lambda t, u, p: np.stack([p[:, 0] * np.cos(t), u * u], axis=1)
        da = lambda t, u, p: np.stack(
            [np.stack([np.cos(t), 0 * t], axis=1), np.stack([0 * t, 2 * u], axis=1)], axis=1
        )
    else:
        a = lambda t, u, p: [p[0] * np.cos(t), u * u]
        da = lambda t, u, p: [[np.cos(t), 0.0], [0.0, 2 * u]]

    def solve(values, p=1.3, **others):
        return cg.solve_linear(
            a, (0, 1.5), y0, frame=frame, inputs=cg.Samples(times, values, kind), parameters=[p],
            vectorized=vectorized, **others,
        )  # fmt: skip

    run = solve(values, derivatives="adjoint", da_dp=da if exact else None, rtol=1e-8, atol=1e-8)
    gradient = run.gradient(c)
    way, step = rng.standard_normal(8), 1e-4
    ends = [np.vdot(c, solve(values + s * way, 1.3 + s, **TIGHT).y[-1]).real for s in (step, -step)]
    actual = gradient.inputs @ way + gradient.parameters[0]
    assert abs(actual - (ends[0] - ends[1]) / (2 * step)) < 1e-6
