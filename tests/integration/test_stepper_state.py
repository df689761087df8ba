"""What copies of steppers carry, and what a restart at an earlier time forgets."""

import copy

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import cg
from cg.frames import SO3, Euclidean

COUNTS = ("nfev", "nexp", "njev", "nlu", "nrejected")


def broken(t, y):
    """A rate with jumps that steps have to find."""
    return [np.sign(np.sin(5.0 * t)), 0.3 * np.cos(9.0 * t), y[0, 1]]


def van_der_pol(t, y):
    return [y[1], 200.0 * (1.0 - y[0] ** 2) * y[1] - y[0]]


def broken_rows(t, y):
    return np.stack([broken(*each) for each in zip(t, y, strict=True)])


RUNS = {
    **{name: (broken, np.eye(3), 3.0, {"method": name, "frame": SO3()})
       for name in ("auto", "CF5(4)", "RKMK5(4)", "DICG3(2)", "RadauIIA5")},
    "stiff": (van_der_pol, [2.0, 0.0], 200.0, {"method": "RadauIIA5", "frame": Euclidean(2)}),
    "members": (broken_rows, [np.eye(3)] * 2, 3.0,
                {"method": "CF5(4)", "frame": SO3(), "vectorized": True, "common_steps": True}),
}  # fmt: skip


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("name", RUNS)
def test_copies_of_each_step_take_the_steps_of_one_run(name, direction):
    """Near jumps and in stiff equations, where sizes depend on what earlier steps have seen."""
    f, y0, end, options = RUNS[name]
    forward = (lambda t, y: -np.array(f(-t, y))) if direction < 0 else f
    stepper = cg.Stepper(forward, 0.0, y0, direction * end, rtol=1e-5, atol=1e-5, **options)
    twin = copy.copy(stepper)
    while stepper.status == "running":
        twin = copy.copy(twin)
        assert stepper.step() is None is twin.step()
        assert twin.t == stepper.t
        assert_array_equal(twin.next_step, stepper.next_step)
        assert_array_equal(twin.y, stepper.y)
        assert [getattr(twin, n) for n in COUNTS] == [getattr(stepper, n) for n in COUNTS]
    assert stepper.nrejected > 5


def turning(t, y, *u):
    rate = u[0] if u else 1.0 if abs(t) < 0.5 else -2.0
    return [rate, 0.2 * np.cos(t), y[0, 1]]


@pytest.mark.parametrize("way", [
    {"rtol": 1e-6}, {"rtol": 1e-6, "method": "RadauIIA5"}, {"method": "CF4", "h": 0.1},
])  # fmt: skip
@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("stops", ["breakpoints", "inputs"])
def test_a_restart_at_an_earlier_time_forgets_all_after_it(stops, direction, way):
    at = np.sort(direction * np.array([0.0, 0.5, 1.0, 1.5]))
    given = {"breakpoints": direction * np.array([0.5, 1.0])}
    if stops == "inputs":
        given = {"inputs": cg.Samples(at, [1.0, -2.0, 3.0, 0.5])}
    event = cg.Event(lambda t, y, *_: abs(t) - 0.7)
    late = 0.8 if stops == "inputs" else 0.0  # breakpoints lie beyond the start
    again, new = (
        cg.Stepper(turning, direction * t0, np.eye(3), direction * 1.4, frame=SO3(), events=event,
                   **way, **given) for t0 in (late, 0.0)
    )  # fmt: skip
    again.advance(direction * 1.2)
    again.restart(t=0.0, y=np.eye(3))
    while new.status == "running":
        assert again.step() is None is new.step()
        assert (again.t, again.t_old, again.status) == (new.t, new.t_old, new.status)
        assert_array_equal(again.y, new.y)
    assert again.t_events[0].tolist() == (1 if late else 2) * new.t_events[0].tolist()
