"""Integrations backward in time, against the reversed equation forward in time."""

import numpy as np
import pytest

import cg
from cg.frames import SO3, Euclidean, Product, Sphere

END = 2.0
POINTS = [1.25, 0.75]  # of breakpoints; END minus them is exact
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
