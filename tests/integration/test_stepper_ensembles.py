"""Steppers of ensembles."""

import copy

import numpy as np
import pytest
from bouncing_ball import fall, height
from numpy.testing import assert_array_equal
from refusals import refuses
from right_hand_sides import OPTIONS

import cg
from cg.frames import SO3, Euclidean


@pytest.mark.parametrize("common", [False, True])
@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("fails", ["message", "value", "exception"])
def test_an_ensemble_of_which_a_member_fails_stays_where_it_was(fails, vectorized, common):
    def f(t, y, rate):
        late = np.asarray(t)[..., None] > 1.0
        if fails == "exception" and np.any(late & (rate > 2.0)):
            raise KeyError("third")
        bad = {"message": rate[..., :1] * y**2, "value": np.where(late, np.nan, y)}
        return np.where(rate[..., :1] > 2.0, bad.get(fails, y), y)

    y0, rates = np.full((3, 1), 0.5), np.array([[1.0], [2.0], [3.0]])
    stepper = cg.Stepper(
        f, 0.0, y0, frame=Euclidean(1), parameters=rates, vectorized=vectorized,
        common_steps=common, method="DP5(4)", **OPTIONS,
    )  # fmt: skip
    assert stepper.advance(0.25) is None
    before = stepper.y
    if fails != "exception":
        message = stepper.advance(2.0)
        assert message.startswith("Failure of ")
        assert "of 3 trajectories" in message
        refuses(RuntimeError, "has failed at t = 0.25; restart", stepper.advance, 2.0)
    else:
        refuses(KeyError, "third", stepper.advance, 2.0)
    assert stepper.t == 0.25
    assert_array_equal(stepper.y, before)
    stepper.restart()
    assert stepper.advance(0.5) is None
    np.testing.assert_allclose(stepper.y[:2], 0.5 * np.exp(0.5), rtol=3e-8)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("method", ["CF4(3)", "RKMK5(4)", "DOP853"])
@pytest.mark.parametrize("members", [0, 1, 2])
def test_points_replaced_after_each_step_take_no_more_evaluations(members, method, sign):
    """A filter that gives back the same points, between samples and step by step."""
    f = lambda t, y: [np.sin(t), 1.0, y[0, 1]]
    y0 = np.stack([np.eye(3)] * members) if members else np.eye(3)
    options = {"frame": SO3(), "method": method, "rtol": 1e-6, "atol": 1e-6}
    options |= {"common_steps": members == 2}

    def evaluations(replaces, steps):
        stepper = cg.Stepper(f, 0.0, y0, np.copysign(np.inf, sign), **options)
        assert stepper.next_step is None or np.isnan(stepper.next_step).all()
        while abs(stepper.t) < 10.0:
            stepper.step() if steps else stepper.advance(stepper.t + sign)
            if replaces:
                proposed = stepper.next_step
                stepper.restart(y=stepper.y)
                assert np.array_equal(stepper.next_step, proposed)
        return stepper.nfev / abs(stepper.t)

    for steps in [False, True][: 1 + (members != 1)]:
        assert evaluations(True, steps) < 1.2 * evaluations(False, steps)


def test_what_lets_the_next_step_be_chosen_anew():
    f = lambda t, y, rate: [rate, 0.0, t]
    stepper = cg.Stepper(f, 0.0, np.eye(3), frame=SO3(), first_step=0.01, args=(1.0,))
    assert stepper.next_step == 0.01
    stepper.advance(1.0)
    kept = stepper.next_step
    assert kept > 0.05
    stepper.restart(args=(2.0,))
    assert stepper.next_step == kept
    stepper.restart(t=0.0)
    assert stepper.next_step == 0.01
    stepper.restart(first_step=0.2)
    assert stepper.next_step == 0.2
    fixed = cg.Stepper(f, 0.0, np.eye(3), frame=SO3(), h=0.1, method="CF4", args=(1.0,))
    fixed.restart(t=1.0)
    assert fixed.next_step == 0.1


HEIGHTS = np.array([[0.5, 0.0], [1.0, 0.0], [8.0, 1.0]])
LANDS = cg.Event(height, direction=-1, terminal=True)
HALF = cg.Event(lambda t, y: y[0] - 0.25)


def dropped(events, t_bound=np.inf, f=fall, **options):
    given = {"frame": Euclidean(2), "events": events, "rtol": 1e-9, "atol": 1e-9}
    return cg.Stepper(f, 0.0, HEIGHTS, t_bound, **given | options)


@pytest.mark.parametrize("common", [False, True])
def test_members_that_stopped_stay_through_restarts_and_copies(common):
    stepper = dropped([LANDS, HALF], common_steps=common)
    while not stepper.stopped.any():
        stepper = copy.copy(stepper)
        assert (stepper.step() if common else stepper.advance(stepper.t + 0.1)) is None
    stepper.restart()
    stepper = copy.copy(stepper)
    first = stepper.y[0]
    if common:
        stepper.step()
        middle = stepper.dense_output()(stepper.t)
        assert_array_equal(np.isnan(middle[:, 0]), stepper.stopped)
    assert stepper.advance(0.9) is None
    assert stepper.stopped.tolist() == [True, True, False]
    assert_array_equal(stepper.y[0], first)
    message = stepper.advance(3.0)
    assert message.startswith("A terminal event")
    assert stepper.status == "event"
    assert stepper.t == max(t[0] for t in stepper.t_events[0])
    refuses(RuntimeError, "has stopped at t = ", stepper.advance, 3.0)
    stepper.restart(y=HEIGHTS)
    assert not stepper.stopped.any()
    assert stepper.advance(stepper.t + 0.2) is None


@pytest.mark.parametrize("options", [{"h": 0.1}, {"max_step": 0.1}])
@pytest.mark.parametrize("t_bound", [3.0, -3.0])
def test_the_last_step_is_that_of_the_member_that_stopped_last(options, t_bound):
    event = cg.Event(lambda t, y: y[0] - 1.0, terminal=True)
    stepper = cg.Stepper(
        lambda t, y: [t_bound / 3.0], 0.0, [[0.75], [0.0], [0.5]], t_bound, frame=Euclidean(1),
        method="CF4(3)", common_steps=True, events=event, **options,
    )  # fmt: skip
    before = [0.0]
    while stepper.status == "running":
        stepper.step()
        assert stepper.t_old == before[-1]
        assert 0.0 < stepper.step_size < 0.1 + 1e-12
        before.append(stepper.t)
    assert abs(stepper.t) == pytest.approx(1.0, abs=1e-12)


def test_a_call_that_fails_has_no_events_and_stops_no_member():
    def f(t, y):
        if broken and y[0] < 0.2 and y[1] < -4.5:
            raise KeyError("third")
        return fall(t, y)

    broken = True
    stepper = dropped([LANDS, HALF], f=f)
    stepper.advance(0.35)
    before, events = stepper.stopped, stepper.t_events
    refuses(KeyError, "third", stepper.advance, 3.0)
    assert stepper.t == 0.35
    assert_array_equal(stepper.stopped, before)
    for own, others in zip(stepper.t_events, events, strict=True):
        assert list(map(len, own)) == list(map(len, others))
    broken = False
    assert stepper.advance(0.7) is None
    assert stepper.stopped.tolist() == [True, True, False]
