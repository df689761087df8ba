"""Events of a stepper: those of solve_ivp, after each of which it goes on."""

import numpy as np
import pytest
from bouncing_ball import bounce, fall, height

import cg
from cg.frames import Euclidean

pytestmark = pytest.mark.sanitize

OPTIONS = {"frame": Euclidean(2), "rtol": 1e-9, "atol": 1e-9}
UP = [1.0, 0.5]


FLOOR = cg.Event(height, direction=-1, jump=bounce)
STOP = cg.Event(height, direction=-1, jump=bounce, terminal=True)
APEX = cg.Event(lambda t, y: y[1], direction=-1)
REFERENCE = cg.solve_ivp(
    fall, (0, 2), UP, events=[FLOOR, APEX], max_step=0.1, dense_output=True, **OPTIONS
)


def assert_same_events(stepper, run=REFERENCE):
    for name in ("t_events", "y_events", "y_after"):
        for own, others in zip(getattr(stepper, name), getattr(run, name), strict=True):
            np.testing.assert_allclose(own, others, rtol=0, atol=1e-12)


@pytest.mark.parametrize("go_on", ["advance", "restart", "step"])
def test_it_stops_at_terminal_events_and_goes_on(go_on):
    stepper = cg.Stepper(fall, 0, UP, 2.0, events=[STOP, APEX], **OPTIONS)
    count = 0
    while (message := stepper.advance(2.0)) is not None:
        assert message.startswith("A terminal event")
        assert stepper.status == "event"
        assert stepper.t == stepper.t_events[0][-1]
        np.testing.assert_allclose(stepper.y, REFERENCE.y_after[0][count], rtol=0, atol=5e-13)
        inside = stepper.dense_output()(0.5 * (stepper.t_old + stepper.t))
        energies = [9.81 * y + v**2 / 2 for y, v in (inside, stepper.y_events[0][-1])]
        np.testing.assert_allclose(*energies, rtol=0, atol=2e-12)
        count += 1
        if go_on == "restart":
            stepper.restart()
        elif go_on == "step":
            stepper.step()
    assert count == len(REFERENCE.t_events[0])
    assert_same_events(stepper)


class TestFailures:
    @pytest.mark.parametrize("fails_at", range(1, 187, 3))
    def test_after_an_exception_the_step_is_taken_again(self, fails_at):
        """In the function of either of two simultaneous events, or in a jump."""
        calls = 0

        def guarded(value):
            nonlocal calls
            calls += 1
            if calls == fails_at:
                raise KeyError("lost")
            return value

        def stepper(guarded):
            floor = cg.Event(lambda t, y: guarded(y[0]), direction=-1,
                             jump=lambda t, y: guarded(bounce(t, y)))  # fmt: skip
            events = [floor, lambda t, y: guarded(2 * y[0])]
            return cg.Stepper(fall, 0, UP, events=events, frame=Euclidean(2), method="CF4", h=0.5)

        failing, without = stepper(guarded), stepper(lambda value: value)
        with pytest.raises(KeyError):
            failing.advance(4.0)
        failing.advance(4.0)
        without.advance(4.0)
        np.testing.assert_allclose(failing.y, without.y, rtol=0, atol=1e-13)
        assert_same_events(failing, without)

    def test_a_resting_contact(self):
        rest = cg.Event(height, direction=-1, jump=lambda t, y: [0.0, 0.0])
        stepper = cg.Stepper(fall, 0, UP, events=rest, **OPTIONS)
        assert "events[0]" in stepper.advance(5.0)
        assert stepper.status == "failed"
        np.testing.assert_allclose(stepper.t, REFERENCE.t_events[0][0], rtol=0, atol=1e-14)
        stepper.restart(y=[1.0, 0.0])
        assert stepper.advance(stepper.t + 0.1) is None

    def test_refused_arguments(self):
        with pytest.raises(ValueError, match="events must have no jumps with common_steps"):
            cg.Stepper(fall, 0, [UP, UP], events=FLOOR, common_steps=True, **OPTIONS)
        with pytest.raises(TypeError, match="events must be a function"):
            cg.Stepper(fall, 0, UP, events=3, **OPTIONS)
        assert cg.Stepper(fall, 0, UP, **OPTIONS).t_events is None


def test_new_arguments_change_events():
    event = cg.Event(lambda t, y, goal: y[0] - goal, terminal=True)
    options = {"frame": Euclidean(1), "args": (1.0,), "events": event}
    stepper = cg.Stepper(lambda t, y, goal: [1.0], 0, [0.0], **options)
    for goal in (1.0, 2.0, 3.5):
        stepper.restart(args=(goal,))
        assert stepper.advance(9.0) is not None
        np.testing.assert_allclose(stepper.t, goal, rtol=1e-14)


def test_events_at_the_end_of_a_step_that_go_on_cost_nothing():
    events = [cg.Event(lambda t, y: t - 0.5, terminal=2)]
    options = {"events": events, "breakpoints": [0.25, 0.5, 0.75], **OPTIONS}
    plain = cg.solve_ivp(fall, (0, 1), UP, method="RKMK8(5,3)", **options)
    stepper = cg.Stepper(fall, 0, UP, 1.0, method="RKMK8(5,3)", **options)
    while stepper.status == "running":
        stepper.step()
        middle = (stepper.t_old + stepper.t) / 2
    assert stepper.nfev == plain.nfev
    assert stepper.t_events[0] == [0.5]
    fine = cg.solve_ivp(fall, (0, 1), UP, dense_output=True, **OPTIONS)
    np.testing.assert_allclose(stepper.dense_output()(middle), fine.sol(middle), rtol=0, atol=3e-13)


@pytest.mark.parametrize("members", [1, 5])
def test_events_of_a_call_stay_as_they_are_in_later_calls(members):
    def f(t, y):
        return [np.pi * y[1], -np.pi * y[0]]  # a zero at k + 1/2

    y0 = [[1.0, 0.0]] * members if members > 1 else [1.0, 0.0]
    options = {"frame": Euclidean(2), "method": "CF4", "h": 0.25, "events": lambda t, y: y[0]}
    stepper = cg.Stepper(f, 0.0, y0, **options)
    for end in np.arange(45 // members, 150 // members, 45 // members):  # 45 events in each call
        stepper.advance(float(end))
        times = np.reshape(stepper.t_events[0], (members, -1))
        np.testing.assert_allclose(times, [np.arange(end) + 0.5] * members, rtol=0, atol=0.4)
