"""Integrations backward in time, against the reversed equation forward in time."""

import numpy as np
import pytest

import cg
from cg.frames import SO3, Euclidean, Product, Sphere

END = 2.0
POINTS = [1.25, 0.75]  # breakpoints; END minus them is exact
TIMES = np.array([2.0, 1.9, 1.25, 1.0, 0.75, 0.31, 0.0])
WAYS = [{"method": "CF5(4)", "rtol": 1e-9, "atol": 1e-9}, {"method": "CG4a", "h": 0.02},
        {"method": "RKMK5(4)", "rtol": 1e-9, "atol": 1e-9}]  # fmt: skip


@pytest.fixture(params=[SO3(), Sphere(2), Product(SO3(), Euclidean(2))], ids=repr)
def problem(request):
    """Return a frame, two points, and an equation with jumps, backward and forward in time."""
    frame, rng = request.param, np.random.default_rng(3)
    amplitudes = rng.uniform(-1, 1, (3, frame.dim))

    def f(t, y, factor):
        return factor * np.tensordot([1.0, np.sin(2 * t), y.ravel()[0]], amplitudes, 1)

    backward = lambda t, y: f(t, y, 0.5 if t > 1.25 else 2.0 if t > 0.75 else 1.0)
    forward = lambda s, y: -f(END - s, y, 0.5 if s < 0.75 else 2.0 if s < 1.25 else 1.0)
    return frame, frame.random_point(rng, 2), backward, forward


def both(solve, problem, y0, way, events):
    """Solve both equations; events have functions of time, a sign of direction, and options."""
    frame, _, backward, forward = problem
    given = [cg.Event(g, **options) for g, options in events]
    turned = [cg.Event(lambda s, y, g=g: g(END - s, y), **options) for g, options in events]
    common = {"frame": frame, "dense_output": True, **way}
    return (
        solve(backward, (END, 0), y0, breakpoints=POINTS, t_eval=TIMES, events=given, **common),
        solve(
            forward, (0, END), y0, breakpoints=[END - t for t in POINTS], t_eval=END - TIMES,
            events=turned, **common,
        ),
    )  # fmt: skip


def agree(x, y, tolerance=1e-7):
    assert len(x) == len(y)
    np.testing.assert_allclose(x, y, rtol=0, atol=tolerance)


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_output_and_events(problem, way):
    _, (y0, other), *_ = problem
    events = [
        (lambda t, y: y.ravel()[0] - 0.1, {}),
        (lambda t, y: np.sin(5 * t), {"direction": 1}),
        (lambda t, y: t - 1.1, {"jump": lambda t, y: other}),
    ]
    run, reverse = both(cg.solve_ivp, problem, y0, way, events)
    np.testing.assert_array_equal(run.t, TIMES)
    agree(run.y, reverse.y)
    grid = np.linspace(0, END, 50)
    agree(run.sol(END - grid), reverse.sol(grid))
    assert len(run.t_events[1]) == 2  # at 2π/5 and 4π/5 it rises with -t, as sin(5t) falls
    for i in range(3):
        agree(run.t_events[i], END - reverse.t_events[i])
        agree(run.y_events[i], reverse.y_events[i])


def fall(t, *_):
    return [-1.0]


def at_sixteen(t, y, *_):
    return y[0] - 1.6


STOP = cg.Event(at_sixteen, terminal=True)
ADJOINT = {"derivatives": "adjoint"}
OBSERVED = {"observe": lambda t, y: y[0] - t, "store": "observed"}
CALLERS = [
    *((cg.solve_ivp, options) for options in ({}, {"h": 0.3}, {"dense_output": True}, OBSERVED)),
    *((cg.solve_linear, options) for options in ({}, {"h": 0.3}, ADJOINT)),
    *((cg.solve_variational, options) for options in ({}, ADJOINT)),
    (cg.solve_ensemble, {}),
    (cg.solve_ensemble, OBSERVED | {"dense_output": True}),
    (cg.solve_linear_ensemble, {}),
    (cg.solve_variational_ensemble, {"dense_output": True}),
]  # fmt: skip


TIMES_ASKED = [None, [], [0.5], [1.0], [0.95, 0.7, 0.5]]


def is_possible(options, end, times):
    """Gradients need a time and take no events; equal steps have an end; times are in the span."""
    endless, adjoint = end == -np.inf, options is ADJOINT
    lasts = min(times or [1.0]) >= end
    return lasts and not (endless and ("h" in options or adjoint)) and (times != [] or not adjoint)


CASES = [
    (solve, options, end, times)
    for solve, options in CALLERS for end in (0.0, 1.0, -np.inf) for times in TIMES_ASKED
    if is_possible(options, end, times)
]  # fmt: skip


@pytest.mark.parametrize(("solve", "options", "end", "times"), CASES)
def test_every_result_knows_the_direction(solve, options, end, times):
    """The solution is y0 + 1 - t, up to the event at 1.6 without gradients."""
    many = "ensemble" in solve.__name__
    y0 = np.array([[1.0], [1.5]]) if many else np.array([1.0])
    events = None if options is ADJOINT else STOP
    solution = solve(fall, (1.0, end), y0, frame=Euclidean(1), t_eval=times, events=events,
                     **options)  # fmt: skip
    members = [solution[0], solution[1]] if many else [solution]
    for member, start in zip(members, y0.reshape(-1, 1)[:, 0], strict=True):
        last = max(end, start + 1 - 1.6) if events else end
        if times is None:
            times_of = member.t
            assert member.t[0] == 1.0
            assert many or abs(member.t[-1] - last) < 1e-12
        else:
            times_of = [t for t in times if t >= last]
        agree(member.t, times_of, 0.0)
        found = member.y[:, 0] if member.y is not None else member.observed + member.t
        agree(found, start + 1 - member.t, 1e-12)
        if member.sol is not None:
            agree(member.sol(member.sol.ts)[:, 0], start + 1 - member.sol.ts, 1e-12)
            assert (np.diff(member.sol.ts) <= 0).all()
        if options is ADJOINT:
            agree(member.gradient(np.ones((len(member.t), 1))).y0, [len(member.t)], 1e-9)
    if many and solution.sol is not None:
        assert (np.diff(solution.sol.ts) < 0).all()


def test_steps_know_the_direction():
    stepper = cg.Stepper(fall, 1.0, [1.0], -np.inf, frame=Euclidean(1), events=STOP)
    while stepper.status == "running":
        stepper.step()
        ts = stepper.dense_output().ts
        assert stepper.direction == -1.0
        assert ts[-1] < ts[0]
    agree([stepper.t], [0.4], 1e-12)


@pytest.mark.parametrize("solve", [cg.solve_variational, cg.solve_linear])
def test_gradients_need_an_output_time(solve):
    with pytest.raises(ValueError, match="t_eval must hold a time with derivatives='adjoint'"):
        solve(fall, (1, 0), [1.0], frame=Euclidean(1), t_eval=[], **ADJOINT)
