"""Jumps at events: their times, the points before and after, terminal jumps."""

import numpy as np
import pytest
from bouncing_ball import GRAVITY, KEPT, bounce, fall, height
from refusals import refuses

import cg
from cg.frames import SO3, Euclidean

pytestmark = pytest.mark.sanitize

FLOOR = cg.Event(height, direction=-1, jump=bounce)


def drop(t_span=(0.0, 3.0), y0=(1.0, 0.0), **options):
    options = {"events": FLOOR, "rtol": 1e-9, "atol": 1e-9} | options
    if "h" in options:
        options = {"method": "CG4a"} | options | {"rtol": None, "atol": None}
    return cg.solve_ivp(fall, t_span, y0, frame=Euclidean(2), **options)


def impacts(count):
    """Return when the ball from height one hits the floor, and how fast."""
    speed = np.sqrt(2 * GRAVITY)
    times, speeds = [speed / GRAVITY], [speed]
    for _ in range(count - 1):
        speeds.append(KEPT * speeds[-1])
        times.append(times[-1] + 2 * speeds[-1] / GRAVITY)
    return np.array(times), np.array(speeds)


@pytest.mark.parametrize("options", [{}, {"h": 0.07}, {"h": 1.0}, {"method": "RKMK5(4)"}])
def test_a_bouncing_ball_is_the_closed_form(options):
    solution = drop(dense_output=True, **options)
    times, speeds = impacts(4)
    assert (solution.status, solution.success) == (0, True)
    np.testing.assert_allclose(solution.t_events[0], times, rtol=0, atol=2e-13)
    np.testing.assert_allclose(solution.y_events[0][:, 0], 0.0, rtol=0, atol=2e-14)
    np.testing.assert_allclose(solution.y_events[0][:, 1], -speeds, rtol=0, atol=1e-12)
    expected = [[0.0, -KEPT * y[1]] for y in solution.y_events[0]]
    np.testing.assert_array_equal(solution.y_after[0], expected)
    at = np.linspace(0.0, 3.0, 41)
    at_times = drop(t_eval=at, **options)
    np.testing.assert_array_equal(at_times.y, solution.sol(at))
    np.testing.assert_allclose(at_times.t_events[0], times, rtol=0, atol=2e-13)


@pytest.mark.parametrize("h", [0.3, 0.5])
def test_a_return_to_zero_within_the_first_part_of_a_step(h):
    """The force turns, so that the ball is in the air again at the end of the step."""
    options = {"frame": Euclidean(2), "method": "CG4a", "events": cg.Event(
        height, direction=-1, jump=lambda t, y: [0.0, -0.3 * y[1]]
    )}  # fmt: skip
    exact, coarse = (
        cg.solve_ivp(
            lambda t, y: [y[1], 60.0 * t - 10.0], (-0.1, 0.6), [0.14, -0.9], h=h, **options
        )
        for h in (0.01, h)
    )
    assert exact.t_events[0].size >= 2
    np.testing.assert_allclose(coarse.t_events[0], exact.t_events[0], rtol=0, atol=5e-15)


def test_jumps_without_progress_end_the_integration():
    """Two events that send the solution back to each other."""
    events = [
        cg.Event(lambda t, y: y[0] - 1.0, direction=1, jump=lambda t, y: [np.nextafter(2.0, 0.0)]),
        cg.Event(lambda t, y: y[0] - 2.0, direction=1, jump=lambda t, y: [np.nextafter(1.0, 0.0)]),
    ]
    solution = cg.solve_ivp(
        lambda t, y: [1.0], (0, 3), [0.0], frame=Euclidean(1), events=events, rtol=1e-8
    )
    assert (solution.status, solution.success) == (-1, False)
    assert "jumps of events follow each other without progress at t = 1" in solution.message


@pytest.mark.parametrize("end", [30.0, -30.0])
def test_jumps_right_behind_starts_of_steps_are_progress(end):
    """Ten tenths are less than one by rounding, in each of 29 turns."""
    options = {"frame": Euclidean(1), "method": "LieEuler", "h": 0.1}
    fire = cg.Event(lambda t, y: y[0] - 1.0, jump=lambda t, y: [0.0])
    s = cg.solve_ivp(lambda t, y: [np.sign(end)], (0, end), [0.0], events=fire, **options)
    assert s.success, s.message
    np.testing.assert_allclose(np.abs(s.t_events[0])[:29], np.arange(1, 30), rtol=0, atol=1e-12)


@pytest.mark.parametrize("options", [{}, {"method": "RadauIIA5"}, {"method": "CG4a", "h": 0.3}])
@pytest.mark.parametrize("direction", [-1, 0])
@pytest.mark.parametrize("kept", [0.0, 0.01, 0.5, 0.8, 0.9])
def test_a_ball_that_comes_to_rest_ends_the_integration(kept, direction, options):
    """The bounces have a limit, and below it the ball would fall through the floor."""
    floor = cg.Event(height, direction=direction, jump=lambda t, y: [0.0, -kept * y[1]])
    rest = cg.solve_ivp(fall, (0.0, 20.0), [1.0, 0.0], frame=Euclidean(2), events=floor, **options)
    limit = np.sqrt(2.0 / GRAVITY) * (1.0 + kept) / (1.0 - kept)
    assert rest.status == -1
    assert any(text in rest.message for text in ("events[0] leaves", "without progress"))
    assert rest.t[-1] == pytest.approx(limit, abs=1e-10)
    assert np.abs(rest.y[-1]).max() < 1e-11
    assert rest.y[:, 0].min() > -1e-13


@pytest.mark.parametrize("start", np.linspace(0.9, 1.1, 5))
@pytest.mark.parametrize("options", [{}, {"method": "CG4a", "h": 0.5}])
def test_noise_of_a_function_after_a_jump_is_no_event(start, options):
    """The ball rests on the floor; a function of numbers of 1e6 is exact to 1e-10 only."""

    noise = lambda t: 1e-10 * np.sin(1e12 * t)
    floor = cg.Event(
        lambda t, y: y[0] + noise(t), direction=-1, jump=lambda t, y: [-noise(t), 0.0, y[2]]
    )
    rest = cg.solve_ivp(
        lambda t, y: [y[1], -GRAVITY, 0.0], (0, 1), [start, 0.0, 1e6], frame=Euclidean(3),
        events=floor, **options,
    )  # fmt: skip
    assert "events[0] leaves its function at zero" in rest.message
    assert len(rest.t_events[0]) == 1


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]])
@pytest.mark.parametrize("spread", [0.0, -1e-12])
def test_events_at_the_same_time_happen_in_any_order(order, spread):
    """Two balls, a count of the impacts of the first, and an event that ends at the third."""

    bounce_of = lambda k: lambda t, y: [*y[:k], 0.0, -KEPT * y[k + 1], *y[k + 2 :]]
    events = [
        cg.Event(lambda t, y: y[0], direction=-1, jump=bounce_of(0)),
        # with rounding errors of its own
        cg.Event(lambda t, y: (y[2] + 1e3) - 1e3, direction=-1, jump=bounce_of(2)),
        cg.Event(lambda t, y: 3.0 * y[0], direction=-1),
        cg.Event(lambda t, y: y[0] / 3.0, direction=-1, terminal=3),
    ]
    solution = cg.solve_ivp(
        lambda t, y: [y[1], -GRAVITY, y[3], -GRAVITY], (0, 3), [1.0, 0.0, 1.0 + spread, 0.0],
        frame=Euclidean(4), events=[events[k] for k in order], dense_output=True,
    )  # fmt: skip
    times, speeds = impacts(3)
    assert solution.status == 1
    for k, event in enumerate(order):
        np.testing.assert_allclose(solution.t_events[k], times, rtol=0, atol=5e-11)
        if event > 1:
            np.testing.assert_allclose(solution.y_events[k][:, 1], -speeds, rtol=0, atol=5e-12)
    np.testing.assert_allclose(solution.y[-1, [1, 3]], KEPT * speeds[-1], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(solution.sol(solution.t[-1]), solution.y[-1])


@pytest.mark.parametrize(("value", "message"), [
    ([0.0], r"events\[1\]\.jump\(t, y\) must have shape \(2,\), got \(1,\)(.|\n)*at t = 0.45"),
    ([0.0, np.nan], r"events\[1\]\.jump\(t, y\) must be finite(.|\n)*at t = 0.45"),
    (None, r"events\[1\]\.jump\(t, y\) must (.|\n)*at t = 0.45"),
    ("up", r"events\[1\]\.jump\(t, y\) must (.|\n)*at t = 0.45"),
    ([1j, 0.0], r"events\[1\]\.jump\(t, y\) must (.|\n)*at t = 0.45"),
])  # fmt: skip
def test_a_wrong_point_after_a_jump_is_named(value, message):
    events = [lambda t, y: 1.0, cg.Event(height, direction=-1, jump=lambda t, y: value)]
    for options in ({}, {"h": 0.1}):
        refuses(ValueError, message, drop, events=events, **options)


def test_a_point_off_the_manifold_after_a_jump_is_refused():
    event = cg.Event(lambda t, y: t - 0.5, jump=lambda t, y: 1.1 * y)
    with pytest.raises(ValueError, match=r"events\[0\]\.jump\(t, y\) must be a point of SO3"):
        cg.solve_ivp(lambda t, y: [0.0, 0.0, 1.0], (0, 1), np.eye(3), frame=SO3(), events=event)


@pytest.mark.parametrize("gap", [1e-10, -1e-10, 0.0, 1e-8])
@pytest.mark.parametrize("t0", [0.0, 1e5, 1e6, -1e7])
def test_events_nearer_than_the_resolution_of_time_happen_once(t0, gap):
    def climb(t, y):
        return [y[0], y[1] + 1]

    events = [cg.Event(lambda t, y, c=c: y[0] - 1 - c, jump=climb) for c in (0.0, gap)]
    for sign in (1.0, -1.0):
        solution = cg.solve_ivp(
            lambda t, y, sign=sign: [sign, 0], (t0, t0 + 2 * sign), [0.0, 0.0], max_step=0.1,
            frame=Euclidean(2), events=events,
        )  # fmt: skip
        assert [len(t) for t in solution.t_events] == [1, 1]
        np.testing.assert_allclose(solution.y[-1], [2, 2], rtol=0, atol=2e-8)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("late", [0.0, 1.0, 2.0])
def test_a_jump_right_behind_a_breakpoint_has_a_time_of_its_own(late, sign):
    """So that the points before and behind it are both in order."""
    stop = sign * 0.3
    event = cg.Event(lambda t, y: t - (stop + late * np.spacing(stop)), jump=lambda t, y: [5.0])
    solution = cg.solve_ivp(
        lambda t, y: [1.0], (0, sign), [0.0], frame=Euclidean(1), events=event, breakpoints=[stop],
        dense_output=True,
    )  # fmt: skip
    assert (sign * np.diff(solution.t) > 0.0).all()
    (at,) = solution.t_events[0]
    assert abs(at - stop) <= 2 * abs(np.spacing(stop))
    assert solution.y[solution.t == at, 0].tolist() == [5.0]
    assert solution.sol(at).tolist() == [5.0]
