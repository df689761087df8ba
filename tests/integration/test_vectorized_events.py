"""Functions of events that take many members at a time: the results of one at a time."""

import ctypes.util
import pickle
from dataclasses import replace

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.frames import SO3, Euclidean

MEMBERS = 40
RATES = np.random.default_rng(2).uniform(0.5, 3.0, (MEMBERS, 2))
UPS = np.random.default_rng(3).uniform([0.5, -2.0], [3.0, 2.0], (MEMBERS, 2))
PUSH = cg.Samples([0.0, 1.0, 2.0, 3.0], [0.0, 2.0, -1.0, 0.5])


def turning(t, y, rate):
    t = np.asarray(t)
    return np.stack([np.sin(t), 0.3 + y[..., 0, 1], t * 0 + rate[..., 0]], axis=-1)


def falling(t, y, u, rate):
    return np.stack([y[..., 1], u - 9.81 * rate[..., 0]], axis=-1)


def angle(t, y, rate):
    return np.arctan2(y[..., 1, 0], y[..., 0, 0]) - rate[..., 1]


def side(t, y, rate):
    return y[..., 2, 0] - 0.1 * rate[..., 1] + 0.01 * np.sin(40.0 * t)


def half_turned(t, y, rate):
    return y @ np.diag([1.0, -1.0, -1.0])


def height(t, y, u, rate):
    return y[..., 0] + 0.01 * u


def speed(t, y, u, rate):
    return y[..., 1] + rate[..., 1]


def bounce(t, y, u, rate):
    return [0.01 - 0.01 * u, -0.7 * y[1]]


TURNING = (
    turning, np.eye(3), SO3(), {},
    [cg.Event(angle, period=2 * np.pi, terminal=3), cg.Event(side, direction=-1), cg.Event(
        lambda t, y, rate: y[..., 0, 0] - 0.2, direction=1, jump=half_turned)],
)  # fmt: skip
FALLING = (
    falling, UPS, Euclidean(2), {"inputs": PUSH},
    [cg.Event(height, direction=-1, jump=bounce, terminal=3), cg.Event(speed)],
)  # fmt: skip
FIELDS = "t", "y", "t_end", "status", "nfev", "nexp", "steps", "nrejected", "transition"


def assert_equal(ours, theirs):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(ours, name, 0), getattr(theirs, name, 0))
    for name in ("t_events", "y_events", "y_after", "dt_events"):
        for own, others in zip(getattr(ours, name) or (), getattr(theirs, name) or (), strict=True):
            assert list(map(len, own)) == list(map(len, others))
            np.testing.assert_array_equal(np.concatenate(own), np.concatenate(others))
    assert sum(map(len, ours.t_events[0])) > MEMBERS / 2
    if ours.sol is not None:
        np.testing.assert_array_equal(ours.sol([0.5, 1.7]), theirs.sol([0.5, 1.7]))


def together(events):
    return [replace(event, vectorized=True) for event in events]


@pytest.mark.parametrize("problem", [TURNING, FALLING])
@pytest.mark.parametrize(
    "options",
    [
        {"dense_output": True},
        {"vectorized": True, "t_eval": np.linspace(0, 3, 31)},
        {"workers": 2},
        {"common_steps": True},
        {"vectorized": True, "common_steps": True, "dense_output": True},
        {"derivatives": "forward"},
        {"method": "RKMK4", "h": 0.11, "rtol": None, "atol": None},
        {"method": "RadauIIA5", "vectorized": True},
    ],
)
def test_results_are_those_of_functions_of_one_member(problem, options):
    f, y0, frame, more, events = problem
    if options.get("common_steps"):
        events = [replace(event, jump=None) for event in events]
    given = {"frame": frame, "parameters": RATES, "rtol": 1e-7, "atol": 1e-7} | more | options

    def solve(events):
        return cg.solve_ensemble(f, (0, 3), y0, events=events, **given)

    assert_equal(solve(together(events)), solve(events))
    assert_equal(solve([together(events)[0], *events[1:]]), solve(events))


def test_each_point_is_evaluated_once_and_points_of_many_members_together():
    sizes, points = [], []

    def many(t, y, rate):
        assert {t.flags.writeable, y.flags.writeable} == {False}
        assert t.shape == y.shape[:1] == rate.shape[:1]
        sizes.append(len(t))
        return angle(t, y, rate)

    def one(t, y, rate):
        points.append(t)
        return angle(t, y, rate)

    f, y0, frame, _, _ = TURNING
    for g in (cg.Event(many, vectorized=True), one):
        cg.solve_ensemble(f, (0, 3), y0, frame=frame, parameters=RATES, events=g)
    assert sum(sizes) == len(points)
    assert len(sizes) < len(points) / 5
    sizes.clear()
    event = cg.Event(many, vectorized=True)
    cg.solve_ivp(f, (0, 3), y0, frame=frame, parameters=RATES[0], events=event)
    assert set(sizes) == {1}


class TestErrors:
    def solve(self, function, solver=cg.solve_ensemble, **options):
        event = cg.Event(function, vectorized=True)
        y0 = UPS if solver is cg.solve_ensemble else UPS[0]
        events = [cg.Event(lambda t, y: y[..., 1], vectorized=True), event]
        return solver(lambda t, y: [y[1], -9.81], (0, 1), y0, frame=Euclidean(2), events=events)

    def test_shape(self):
        text = r"events\[1\] must return an array of shape \(40,\), a row for each member"
        refuses(ValueError, text, self.solve, lambda t, y: y)
        refuses(ValueError, text + ".*got None", self.solve, lambda t, y: None)
        text = r"events\[1\] must return an array of shape \(1,\)"
        refuses(ValueError, text, self.solve, lambda t, y: 1.0, cg.solve_ivp)
        refuses(ValueError, text, self.solve, lambda t, y: y[:, :1], cg.solve_ivp)

    @pytest.mark.parametrize("solver", [cg.solve_ivp, cg.solve_ensemble])
    def test_numbers_that_are_not_finite(self, solver):
        text = r"events\[1\] must return finite numbers, got nan at t = 1"
        with pytest.warns(RuntimeWarning), pytest.raises(ValueError, match=text) as caught:
            self.solve(lambda t, y: np.log(y[:, 0]), solver)
        assert "events[1](t, y, ...)" in caught.value.__notes__[0]

    def test_exceptions(self):
        with pytest.raises(KeyError) as caught:
            self.solve(lambda t, y: {}["lost"])
        assert caught.value.__notes__ == ["in events[1](t, y, ...) at t = 0"]

    def test_flag(self):
        refuses(TypeError, "vectorized must be True or False", cg.Event, height, vectorized=1)
        compiled = cg.CompiledFunction(ctypes.util.find_library("m"), "cos")
        refuses(ValueError, "vectorized must be False", cg.Event, compiled, vectorized=True)


def test_a_stepper_takes_them_and_is_pickled():
    f, y0, frame, more, events = FALLING
    options = {"frame": frame, "parameters": RATES, "events": together(events), **more}
    whole = cg.solve_ensemble(f, (0, 3), y0, **options)
    stepper = pickle.loads(pickle.dumps(cg.Stepper(f, 0.0, y0, 3.0, **options)))
    stepper.advance(3.0)
    np.testing.assert_array_equal(stepper.stopped, whole.status == 1)
    for own, others in zip(stepper.y_after, whole.y_after, strict=True):
        np.testing.assert_array_equal(np.concatenate(own), np.concatenate(others))
