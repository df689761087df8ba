"""Output between fixed steps and events of a compiled f equal those of f in Python."""

import ctypes

import numpy as np
import pytest
from right_hand_sides import CIRCLE, circle, height, solve

import cg
from cg.frames import Euclidean

pytestmark = pytest.mark.sanitize

DOUBLES = ctypes.POINTER(ctypes.c_double)
EVENT = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, DOUBLES, DOUBLES)


def late(t, y):
    return t - 0.45


@pytest.mark.parametrize("options", [{"max_step": 0.01}, {"method": "CG2", "h": 0.01}])
def test_errors_of_f_after_a_terminal_event_are_ignored(options, compiled_function):
    # The function returns an error from one half on.
    f, event = compiled_function("stops"), cg.Event(late, terminal=True)
    line = {"frame": Euclidean(1)} | options
    for extra in ({}, {"t_eval": np.linspace(0, 1, 21)}, {"dense_output": True}):
        solution = cg.solve_ivp(f, (0, 1), [0.0], events=event, **line, **extra)
        assert solution.status == 1
        assert solution.t[-1] == pytest.approx(0.45, abs=2e-15)
        assert solution.t_events[0] == pytest.approx([0.45], abs=2e-15)
    with pytest.raises(RuntimeError, match=r"f returned the error code 7 at t = 0\.5"):
        cg.solve_ivp(f, (0, 1), [0.0], events=late, **line)


def test_an_event_in_the_last_step_before_an_error(compiled_function):
    event = cg.Event(late, terminal=True)
    options = {"frame": Euclidean(1), "method": "LieEuler", "h": 0.25, "events": event}
    solution = cg.solve_ivp(compiled_function("stops"), (0, 2), [0.0], dense_output=True, **options)
    assert (solution.status, solution.steps) == (1, 2)
    assert solution.sol(0.4) == 0.0
    options["h"] = 0.375  # the coefficients at the end of the step with the event can't be had
    options["events"] = late
    with pytest.raises(RuntimeError, match=r"code 7 at t = 0\.75"):
        cg.solve_ivp(compiled_function("stops"), (0, 2), [0.0], **options)


@pytest.mark.parametrize("options", [{}, {"common_steps": True}, {"workers": 2}])
def test_compiled_events_get_the_parameters_of_their_member(options, compiled_function):
    parameters, lanes = [[-1.0, 2.2], [-0.5, 3.0], [-2.0, 3.8]], {"frame": Euclidean(1)} | options
    decays = compiled_function("decays")

    @EVENT
    def half_way(t, y, user_data):
        return t - user_data[1] / 2

    for points in ([[1.0]] * 3, [[1.0], [2.0], [3.0]]):
        run = cg.solve_ensemble(
            decays, (0, 2), points, parameters=parameters, events=half_way, **lanes
        )
        found = np.concatenate(run.t_events[0])
        np.testing.assert_allclose(found, [1.1, 1.5, 1.9], rtol=0, atol=4e-15)


def test_compiled_events_without_data_get_none_of_a_function_in_python():
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, DOUBLES, ctypes.c_void_p)
    given = []

    @kind
    def event(t, y, user_data):
        given.append(user_data)
        return y[1]

    expected = solve(height).t_events[0]
    np.testing.assert_array_equal(solve(event).t_events[0], expected)
    stepper = cg.Stepper(circle, 0.1, [np.cos(0.1), np.sin(0.1)], 10.0, events=event, **CIRCLE)
    stepper.advance(10.0)
    np.testing.assert_allclose(stepper.t_events[0], expected, rtol=0, atol=4e-14)
    cg.solve_variational(circle, (0.1, 4.0), [1.0, 0.1], events=event, **CIRCLE)
    assert set(given) == {None}
    for name, value in (("parameters", [1.0]), ("inputs", cg.Samples([0.0], [1.0]))):
        with pytest.raises(ValueError, match=r"events\[0\] must be in Python with inputs or"):
            solve(event, **{name: value})
