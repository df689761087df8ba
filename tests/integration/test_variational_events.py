"""Derivatives of solutions with events and jumps, of event times, and of ensembles."""

import numpy as np
import pytest
from waves import TIGHT

import cg
from cg.frames import Euclidean

GRAVITY = 9.81


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


@pytest.mark.parametrize("span", [(0.0, 1e-6), (1e-6, 0.0)])
@pytest.mark.parametrize("place", [0.001, 0.1, 0.5, 0.999])
def test_differences_stay_within_the_times_of_inputs(span, place):
    """Also where an event is near one of their ends: y' = p u, an event at a time and a jump."""
    samples = cg.Samples([0.0, 1e-6], [1e6, 1e6], "linear")
    at = 1e-6 * place
    event = cg.Event(lambda t, y, u, p: t - at, jump=lambda t, y, u, p: 2.0 * y)
    solution = cg.solve_variational(
        lambda t, y, u, p: p * u, span, [1.0], frame=cg.frames.Euclidean(1), inputs=samples,
        parameters=[0.5], events=event, rtol=1e-9, atol=1e-9, control_derivatives=True,
    )  # fmt: skip
    assert len(solution.t_events[0]) == 1
    np.testing.assert_allclose(solution.dt_events[0], 0.0, atol=1e-20)
    np.testing.assert_allclose(solution.transition[-1], 2.0, rtol=3e-12)
    expected = 1.0 + place if span[1] > span[0] else place - 2.0  # doubled at the jump
    np.testing.assert_allclose(solution.sensitivity[-1].item(), expected, rtol=2e-10)


@pytest.mark.filterwarnings("ignore:Failure of")
def test_members_that_fail_are_nan():
    f = lambda t, y, p: [p[0] * y[0] ** 2]
    solution = cg.solve_variational_ensemble(
        f, (0, 2), [1.0], frame=Euclidean(1), parameters=[[0.25], [1.0]], t_eval=[0.5, 2.0]
    )
    assert solution.status.tolist() == [0, -1]
    assert np.isfinite(solution.transition[:, 0]).all()
    assert np.isnan(solution.transition[1, 1])
    assert solution[1].transition.shape == (1, 1, 1)
    np.testing.assert_allclose(solution.transition[0, 0], 1 / (1 - 0.125) ** 2, rtol=1e-6)
