"""Constant generators on `LinearAction`, whose steps have thousands of Taylor parts.

The first and the third state turn, the second one doesn't; each keeps its population exactly.
"""

import numpy as np
import pytest
from kinds import MAGNUS

import cg
from cg import _core_r64
from cg.frames import LinearAction

Y0 = np.array([0.6, 0.8, 0.0], complex)
TURNS = 2e4


def frame(damping, **kinds):
    diagonal = np.array([1.0, 0.0, 1.0])
    return LinearAction([np.diag(-(1j + damping) * diagonal)], **kinds)


def population_error(y, damping=0.0, turns=TURNS):
    decay = np.array([np.exp(-2 * damping * turns), 1.0, np.exp(-2 * damping * turns)])
    return np.abs(np.abs(y) ** 2 - decay * np.abs(Y0) ** 2).max()


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("damping", [0.0, 1e-5])
@pytest.mark.parametrize("method", ["auto", *MAGNUS])
def test_every_method_and_tolerance(method, damping, tolerance):
    run = cg.solve_linear(
        lambda t: [TURNS], (0, 1), Y0, frame=frame(damping), method=method,
        rtol=tolerance, atol=tolerance,
    )  # fmt: skip
    assert run.steps < 50
    assert population_error(run.y[-1], damping) < tolerance


@pytest.mark.parametrize("turns", [3e5, 3e6])
def test_errors_do_not_grow_with_the_time(turns):
    before = _core_r64.linear_products()
    run = cg.solve_linear(lambda t: [1.0], (turns, 0), Y0, frame=frame(0.0))
    assert _core_r64.linear_products() - before < 6 * turns
    assert population_error(run.y[-1]) < 1e-3


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_gradients(tolerance):
    run = cg.solve_linear(
        lambda t: [1.0], (0, 5e3), Y0, frame=frame(0.0), rtol=tolerance,
        atol=tolerance, derivatives="adjoint",
    )  # fmt: skip
    gradient = run.gradient(2 * run.y[-1] * [1, 0, 0])
    np.testing.assert_allclose(gradient.y0, [1.2, 0, 0], rtol=0, atol=tolerance)


@pytest.mark.parametrize("end", [1000.0, -1000.0])
def test_all_events_of_long_steps_are_found(end):
    frame = LinearAction([np.array([[0.0, -1.0], [1.0, 0.0]])])
    options = {"frame": frame, "events": lambda t, y: y[0], "rtol": 1e-8, "atol": 1e-8}
    for solution in (
        cg.solve_linear(lambda t: [1.0], (0, end), [1.0, 0.0], **options),
        cg.solve_ivp(lambda t, y: [1.0], (0, end), [1.0, 0.0], **options),
    ):
        assert solution.steps < 20
        times = np.sign(end) * np.pi * (np.arange(318) + 0.5)
        np.testing.assert_allclose(solution.t_events[0], times, rtol=0, atol=1e-8)
