"""Observables, events of a Stepper and tolerances together with inputs from samples."""

import ctypes

import numpy as np
import pytest
from compiled_examples import DOUBLES

import cg
from cg.frames import SO3, Euclidean

HELD = cg.Samples([0.0, 0.5, 1.0], [1.0, -2.0, 3.0])
LINE = Euclidean(1)


def rate(t, y, u):
    return [u]


def exact(t):
    return np.interp(t, [0.0, 0.5, 1.0, 1.5], [0.0, 0.5, -0.5, 1.0])


@pytest.mark.parametrize("store", ["all", "observed"])
@pytest.mark.parametrize("vectorized", [False, True])
def test_observables_get_the_inputs(store, vectorized):
    times = np.linspace(0.05, 1.45, 8)

    observe = lambda t, y, u: [y[..., 0], u]
    options = {"frame": LINE, "inputs": HELD, "t_eval": times, "observe": observe, "store": store}
    if vectorized:
        run = cg.solve_ensemble(
            lambda t, y, u: u[:, None], (0, 1.5), np.zeros((2, 1)), vectorized=True, **options
        )
        observed = run.observed[:, 1]
    else:
        observed = cg.solve_ivp(rate, (0, 1.5), [0.0], **options).observed
    np.testing.assert_allclose(observed[:, 0], exact(times), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(observed[:, 1], [HELD(t) for t in times])


@ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, DOUBLES, DOUBLES, ctypes.c_void_p)
def compiled_rate(t, y, f, data):
    f[0] = ctypes.cast(data, DOUBLES)[0]
    return 0


@ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, DOUBLES, ctypes.c_void_p)
def compiled_input(t, y, data):
    return ctypes.cast(data, DOUBLES)[0]


@pytest.mark.parametrize("functions", [
    (rate, lambda t, y, u: u), (compiled_rate, compiled_input),
], ids=["python", "compiled"])  # fmt: skip
@pytest.mark.parametrize("way", [{}, {"method": "RadauIIA5"}, {"method": "CF4", "h": 0.25}])
@pytest.mark.parametrize("direction", [1, -1])
def test_at_their_times_observables_get_the_values_that_begin_there(functions, way, direction):
    f, observe = functions
    times = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.5])[::direction]
    options = {"frame": LINE, "inputs": HELD, "observe": observe, **way}
    given = f, times[[0, -1]], [0.0]
    expected = [HELD(t) for t in times]
    for solve in (cg.solve_ivp, cg.solve_variational):
        assert solve(*given, t_eval=times, **options).observed.tolist() == expected
    steps = cg.solve_ivp(*given, **options)
    assert set(HELD.times) <= set(steps.t)
    assert steps.observed.tolist() == [HELD(t) for t in steps.t]


def test_members_observe_their_own_inputs():
    own = cg.Samples([0.0, 1.0], [[1.0, 0.0], [2.0, 0.0]], members=True)
    run = cg.solve_ensemble(
        rate, (0, 1), np.zeros((2, 1)), frame=LINE, inputs=own, t_eval=[0.5, 1.0],
        observe=lambda t, y, u: u + y[0],
    )  # fmt: skip
    np.testing.assert_allclose(run.observed[0], [1.5, 3.0], rtol=0, atol=1e-12)


def test_events_of_a_stepper_see_the_inputs():
    event = cg.Event(lambda t, y, u: y[0] - 0.25 * np.sign(u), terminal=True, direction=-1)
    stepper = cg.Stepper(rate, 0.0, [0.0], 1.5, frame=LINE, inputs=HELD, events=event)
    stepper.advance(1.5)
    assert stepper.t < 1.5
    run = cg.solve_ivp(rate, (0, 1.5), [0.0], frame=LINE, inputs=HELD, events=event)
    assert stepper.t == pytest.approx(run.t[-1], abs=1e-12)


def test_noise_and_tolerances_of_coordinates_with_inputs():
    turn = cg.Samples([0.0, 1.0, 2.0], np.eye(3), "linear")
    run = cg.solve_variational(
        lambda t, y, u: u, (0, 2), np.eye(3), frame=SO3(), inputs=turn, noise=0.1 * np.eye(3),
        rtol=[1e-6, 1e-7, 1e-8],
    )  # fmt: skip
    # isotropic noise is turned into itself
    np.testing.assert_allclose(run.covariance[-1], 0.2 * np.eye(3), rtol=0, atol=1e-6)


@pytest.mark.parametrize("options", [{"method": "BlanesMoan6", "h": 0.01}, {"method": "CF5(4)"}])
def test_forces_from_samples_on_a_phase_space(options):
    frame = cg.frames.PhaseSpace(SO3(), inertia=[1.0, 1.6, 2.3])
    torque = cg.Samples([0.0, 0.5, 1.0], [[0.0, 0, 1], [0.0, 0.5, -1], [0.0, 0, 0]])
    y0 = frame.join(np.eye(3), [0.1, 0.2, 0.3])
    if "h" not in options:
        options = options | {"rtol": 1e-11, "atol": 1e-11}
    run = cg.solve_ivp(
        lambda t, y, u: u, (0, 1), y0, frame=frame, inputs=torque, t_eval=[0.3, 1.0],
        observe=lambda t, y, u: y[9:], **options,
    )  # fmt: skip
    exact = cg.solve_ivp(
        lambda t, y: torque(t), (0, 1), y0, frame=frame, breakpoints=[0.5], rtol=1e-12, atol=1e-12,
        t_eval=[0.3, 1.0],
    )  # fmt: skip
    np.testing.assert_allclose(run.y, exact.y, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.observed, exact.y[:, 9:], rtol=0, atol=1e-9)
