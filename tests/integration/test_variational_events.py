"""Derivatives of solutions with breakpoints, events and jumps, and of event times."""

import numpy as np
import pytest
from quotients import jacobian
from waves import TIGHT, Wave

import cg
from cg.frames import SO3, CoadjointOrbit, Euclidean, Product, Sphere

GRAVITY = 9.81
BODY = Product(SO3(), Euclidean(2))


def kick(t, y, p):
    """Turn the attitude about an axis that depends on all, and reflect the height."""
    attitude, height = BODY.split(y)
    turn = [0.3 * p[0], 0.2 * height[1], 0.1 * np.sin(t) * attitude[0, 1]]
    after = [height[0], -p[1] * height[1] + 0.1 * attitude[2, 0]]
    return BODY.join(SO3().flow(turn, attitude), np.array(after))


def tumble(t, y, p):
    attitude, height = BODY.split(y)
    turn = [np.cos(t), 0.5 * p[0] * attitude[0, 2], 0.3 * height[0]]
    return np.concatenate([turn, [height[1], -GRAVITY + attitude[0, 0]]])


FLOOR = cg.Event(lambda t, y, p: y[9] - 0.1 * y[3] - 0.05 * p[0] * t, direction=-1, jump=kick)


def test_jumps_that_depend_on_all():
    y0 = BODY.join(np.eye(3), np.array([1.0, 0.5]))
    p = np.array([0.7, 0.8])
    options = {"frame": BODY, "events": FLOOR, "rtol": 1e-12, "atol": 1e-12}
    span = (0.0, 1.9)
    solution = cg.solve_variational(tumble, span, y0, parameters=p, dense_output=True, **options)
    assert solution.t_events[0].size >= 2
    reference = solution.y[-1]

    def end(x):
        moved = cg.solve_ivp(tumble, span, BODY.flow(x[:5], y0), parameters=p + x[5:], **options)
        assert moved.t_events[0].size == solution.t_events[0].size
        return np.concatenate([BODY.exp_coordinates(reference, moved.y[-1]), moved.t_events[0]])

    derivatives = np.concatenate([solution.transition[-1], solution.sensitivity[-1]], axis=1)
    size = np.abs(derivatives).max()
    expected = jacobian(end, 7, bound=2e-9 * size)
    assert np.abs(derivatives - expected[:5]).max() < 2e-9 * size
    assert np.abs(solution.dt_events[0] - expected[5:]).max() < 2e-9 * size
    # before and after the jump
    time = solution.t_events[0][0]
    after = solution.sol.transition(time)
    before = solution.sol.transition(np.nextafter(time, 0.0))
    assert np.abs(after - before).max() > 0.1
    alone = cg.solve_ivp(tumble, span, y0, parameters=p, **options)
    for name in ("y_events", "y_after", "t_events"):
        found, expected = getattr(solution, name)[0], getattr(alone, name)[0]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("frame", [Sphere(2), CoadjointOrbit(SO3(), (0.6, 0.0, -0.8))], ids=repr)
def test_jumps_on_homogeneous_spaces(frame):
    wave = Wave(frame)
    mirror = cg.Event(
        lambda t, y, p: t - 0.3 - 0.2 * y[0], jump=lambda t, y, p: y * np.array([1.0, -1.0, 1.0])
    )
    derivatives = wave.derivatives(events=mirror)
    assert derivatives.t_events[0].size == 1
    v = np.array([0.3, -0.5, 0.4])
    tangent = frame.field(derivatives.transition[-1] @ v, derivatives.y[-1])
    assert np.abs(tangent - wave.by_fields(v, 2e-9, events=mirror)).max() < 2e-9


@pytest.mark.parametrize("terminal", [False, True])
def test_times_of_events_without_jumps(terminal):
    wave = Wave(SO3())
    level = wave.solve(span=(0.1, 0.4)).y[-1][1, 0]
    shift = wave.parameters[0]
    events = [
        cg.Event(lambda t, y, p: y[1, 0] - level - 0.1 * (p[0] - shift), terminal=terminal),
        lambda t, y, p: t - 0.7 - 0.1 * (p[1] - wave.parameters[1]),
        lambda t, y, p: 1.0,
    ]
    derivatives = wave.derivatives(events=events)
    jumps = [each.size for each in derivatives.t_events]
    assert jumps == [1, 0 if terminal else 1, 0]
    assert [rows.shape for rows in derivatives.dt_events] == [(count, 5) for count in jumps]

    def times(x):
        moved = wave.solve(SO3().flow(x[:3], wave.y0), wave.parameters + x[3:], events=events)
        return np.concatenate(moved.t_events)

    expected = jacobian(times, 5, bound=1e-9)
    np.testing.assert_allclose(
        np.concatenate(derivatives.dt_events), expected, rtol=1e-9, atol=1e-9
    )


def test_backward_in_time():
    """A ball is followed back to the floor and to its start."""
    floor = lambda t, y: y[0]
    solution = cg.solve_variational(
        lambda t, y: [y[1], -GRAVITY], (0, -1), [0.5, 2.0], frame=Euclidean(2), events=floor,
        jac=lambda t, y: [[0.0, 1.0], [0.0, 0.0]], **TIGHT,
    )  # fmt: skip
    impact = np.sqrt(4.0 + GRAVITY)
    expected = [-1 / impact, 1 / GRAVITY - 2 / (impact * GRAVITY)]
    np.testing.assert_allclose(solution.dt_events[0], [expected], atol=1e-9)
    np.testing.assert_allclose(solution.transition[-1], [[1.0, -1.0], [0.0, 1.0]], atol=1e-12)


def test_an_event_that_only_touches_has_no_derivative():
    options = {"frame": Euclidean(1), "t_span": (0, 1), "y0": [1.0], "h": 0.25, "method": "CG4a"}
    solution = cg.solve_variational(
        lambda t, y: [1.0], events=lambda t, y: (y[0] - 1.5) ** 3, **options
    )
    assert solution.t_events[0].tolist() == [0.5]
    assert not np.isfinite(solution.dt_events[0]).any()
    stuck = cg.Event(lambda t, y: (t - 0.5) ** 3, jump=lambda t, y: y)
    with pytest.raises(ValueError, match=r"events\[0\] must change its sign .* is 0 at t = 0.5"):
        cg.solve_variational(lambda t, y: [0.0], events=stuck, **options)


def test_large_derivatives_do_not_hide_small_bounces():
    """The derivative of the last coordinate grows to 5e11; the ball jumps by 1e-10."""
    floor = cg.Event(
        lambda t, y: y[0], direction=-1, jump=lambda t, y: np.array([0.0, -1e-5 * y[1], y[2]])
    )
    arguments = lambda t, y: [y[1], -GRAVITY, 60.0 * y[2]], (0.0, 0.451533), [1.0, 0.0, 0.0]
    options = {"frame": Euclidean(3), "events": floor, **TIGHT}
    alone = cg.solve_ivp(*arguments, **options)
    solution = cg.solve_variational(*arguments, **options)
    assert alone.t_events[0].size >= 2
    np.testing.assert_allclose(solution.t_events[0], alone.t_events[0], rtol=0, atol=1e-15)
