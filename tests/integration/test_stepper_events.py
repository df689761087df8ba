"""Events of a stepper: those of solve_ivp, after each of which it goes on."""

import copy
import pickle

import numpy as np
import pytest
from bouncing_ball import bounce, fall, height

import cg
from cg.frames import SO3, Euclidean

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


@pytest.mark.parametrize("times", [[2.0], np.linspace(0.05, 2, 40)], ids=["once", "often"])
@pytest.mark.parametrize("options", [{}, {"h": 0.01, "method": "CF4", "rtol": None, "atol": None}])
def test_jumps_and_events_are_those_of_solve_ivp(times, options):
    stepper = cg.Stepper(fall, 0, UP, 2.0, events=[FLOOR, APEX], **OPTIONS | options)
    for t in times:
        assert stepper.advance(t) is None
    assert stepper.status == "finished"
    assert_same_events(stepper)
    np.testing.assert_allclose(stepper.y, REFERENCE.y[-1], rtol=0, atol=2e-12)


def test_single_steps_end_at_jumps():
    stepper = cg.Stepper(fall, 0, UP, 2.0, events=[FLOOR, APEX], max_step=0.1, **OPTIONS)
    times = []
    while stepper.status == "running":
        begin = stepper.t
        assert stepper.step() is None
        times.append(stepper.t)
        assert stepper.t_old == begin
        assert stepper.step_size == stepper.t - begin
        sol, middle = stepper.dense_output(), (begin + stepper.t) / 2
        np.testing.assert_allclose(sol(middle), REFERENCE.sol(middle), rtol=0, atol=1e-14)
        assert sol.t_max == stepper.t
    assert_same_events(stepper)
    assert set(stepper.t_events[0]) <= set(times)


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


def test_a_terminal_event_without_a_jump_is_passed():
    for sign in (1, -1):
        event = cg.Event(lambda t, y: y[0], terminal=True)
        stepper = cg.Stepper(
            lambda t, y: [np.cos(t)], 0, [0.0], sign * 10, frame=Euclidean(1), events=event
        )
        found = []
        while stepper.advance(sign * 10):
            found.append(stepper.t)
            if len(found) == 2:
                stepper.restart()  # at the zero, which isn't found again
        np.testing.assert_allclose(found, sign * np.pi * np.array([1, 2, 3]), rtol=0, atol=1e-6)
        assert stepper.status == "finished"


def fall_and_turn(t, y):
    return [np.sin(t), y[0, 0], 1.0]


def level(t, y):
    return y[2, 2]


@pytest.mark.parametrize("convert", [copy.copy, copy.deepcopy,
                                     lambda s: pickle.loads(pickle.dumps(s))])  # fmt: skip
def test_copies_go_on_bit_for_bit(convert):
    event = cg.Event(level, terminal=2)
    stepper = cg.Stepper(fall_and_turn, 0, np.eye(3), frame=SO3(), rtol=1e-6, events=event)
    stepper.advance(2.5)
    while stepper.status != "event":
        twin = convert(stepper)
        assert stepper.step() == twin.step()
        assert (stepper.t, stepper.status) == (twin.t, twin.status)
        assert len(stepper.t_events[0]) == len(twin.t_events[0])
    twin = convert(stepper)
    middle = (stepper.t + stepper.t_old) / 2
    assert np.array_equal(stepper.dense_output()(middle), twin.dense_output()(middle))
    for each in (stepper, twin):
        each.advance(20.0)
    assert stepper.t == twin.t < 20
    assert np.array_equal(stepper.t_events[0], twin.t_events[0])
    assert len(stepper.t_events[0]) == 4


def test_many_events_in_a_step():
    often = cg.Event(lambda t, y: np.sin(200 * t))
    stepper = cg.Stepper(
        lambda t, y: [1.0], 0, [0.0], 20, frame=Euclidean(1), events=[often] * 3, h=0.01,
        method="CF4",
    )  # fmt: skip
    while stepper.status == "running":
        stepper.step()
    for times in stepper.t_events:
        np.testing.assert_allclose(
            times, np.pi / 200 * np.arange(1, len(times) + 1), rtol=0, atol=2e-13
        )
        assert len(times) == 1273


class TestFailures:
    def test_after_an_exception_the_step_is_taken_again(self):
        broken = True

        def jump(t, y):
            if broken:
                raise KeyError("lost")
            return bounce(t, y)

        event = cg.Event(height, direction=-1, jump=jump, terminal=2)
        stepper = cg.Stepper(fall, 0, UP, 2.0, events=[event, APEX], **OPTIONS)
        with pytest.raises(KeyError):
            stepper.advance(2.0)
        assert stepper.t < REFERENCE.t_events[0][0]
        broken = False
        assert stepper.advance(2.0) is not None
        np.testing.assert_allclose(
            stepper.t_events[0], REFERENCE.t_events[0][:2], rtol=0, atol=1e-13
        )

    def test_a_resting_contact(self):
        rest = cg.Event(height, direction=-1, jump=lambda t, y: [0.0, 0.0])
        stepper = cg.Stepper(fall, 0, UP, events=rest, **OPTIONS)
        assert "events[0]" in stepper.advance(5.0)
        assert stepper.status == "failed"
        np.testing.assert_allclose(stepper.t, REFERENCE.t_events[0][0], rtol=0, atol=4e-14)
        stepper.restart(y=[1.0, 0.0])
        assert stepper.advance(stepper.t + 0.1) is None

    def test_refused_arguments(self):
        with pytest.raises(ValueError, match="events must be None for an ensemble"):
            cg.Stepper(fall, 0, [UP, UP], events=FLOOR, **OPTIONS)
        with pytest.raises(TypeError, match="events must be a function"):
            cg.Stepper(fall, 0, UP, events=3, **OPTIONS)
        assert cg.Stepper(fall, 0, UP, **OPTIONS).t_events is None


def test_an_event_at_the_end():
    event = cg.Event(lambda t, y: t - 1.0, terminal=True)
    stepper = cg.Stepper(fall, 0, UP, 1.0, events=event, **OPTIONS)
    assert stepper.advance(1.0) is None
    assert stepper.t == 1.0
    assert stepper.t_events[0].tolist() == [1.0]
    with pytest.raises(RuntimeError, match="has finished"):
        stepper.step()


def test_new_arguments_change_events():
    event = cg.Event(lambda t, y, goal: y[0] - goal, terminal=True)
    options = {"frame": Euclidean(1), "args": (1.0,), "events": event}
    stepper = cg.Stepper(lambda t, y, goal: [1.0], 0, [0.0], **options)
    for goal in (1.0, 2.0, 3.5):
        stepper.restart(args=(goal,))
        assert stepper.advance(9.0) is not None
        np.testing.assert_allclose(stepper.t, goal, rtol=1e-14)


def test_a_step_that_turns_too_far_for_its_events():
    options = {"frame": SO3(), "method": "CF4", "events": lambda t, y: y[0, 0]}
    stepper = cg.Stepper(lambda t, y: [0.0, 0.0, 1.0], 0.0, np.eye(3), 2e10, h=1e10, **options)
    with pytest.raises(cg.StepTooLongError, match="eight million turns") as caught:
        stepper.step()
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
