"""Frames of the user: required members, and warnings about flows that leave the manifold."""

import numpy as np
import pytest

import cg
from cg.frames import FieldFrame


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("good_until", [-1.0, 0.5])
def test_nonnumeric_flows_raise(value, good_until):
    """The flow fails at the first call or at a later one."""

    flow = lambda v, y: y + v if y[0] + v[0] <= good_until else value * np.ones(1)
    frame = FieldFrame([lambda y: np.ones(1)], flow, point_shape=1)
    solution = cg.solve_ivp(lambda t, y: np.ones(1), (0, 1), [0.0], frame=frame)
    assert not solution.success
    assert "the flow of FieldFrame(" in solution.message
    assert "returned NaN or infinity at t = 0" in solution.message
    assert abs(solution.t[-1] - max(good_until, 0.0)) < 1e-14


def drifting(restore=None):
    """A circle whose flow leaves it slightly."""
    return FieldFrame(
        [lambda y: np.array([-y[1], y[0]])],
        lambda v, y: (1 + 1e-7 * abs(v[0])) * np.array(
            [np.cos(v[0]) * y[0] - np.sin(v[0]) * y[1], np.sin(v[0]) * y[0] + np.cos(v[0]) * y[1]]
        ),
        point_shape=2, membership_error=lambda y: abs(np.hypot(*y) - 1), restore=restore,
    )  # fmt: skip


@pytest.mark.parametrize("many", [False, True])
def test_solution_off_the_manifold_warns(many):
    def solve(frame):
        options = {"frame": frame, "method": "CG4a", "h": 0.1}
        if many:
            return cg.solve_ensemble(lambda t, y: [1.0], (0, 1), [[1.0, 0.0]] * 2, **options)
        return cg.solve_ivp(lambda t, y: [1.0], (0, 1), [1.0, 0.0], **options)

    with pytest.warns(UserWarning, match="the solution has left the manifold: .* 1e-08") as caught:
        solve(drifting())
    assert caught[0].filename == __file__
    solve(drifting(lambda y: y / np.hypot(*y)))
