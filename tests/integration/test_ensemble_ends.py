"""Members of ensembles that end early by events or failures; common steps."""

import ctypes
import itertools
import math
import re

import numpy as np
import pytest
from compiled_examples import DOUBLES

import cg
from cg.frames import Euclidean
from cg.integration.run import drive

LINE = {"frame": Euclidean(1)}
RATES, NEVER = np.array([-1.0, -2.0, 0.5, 0.0]), 1e9
CHOSEN = {"rtol": 1e-9, "atol": 1e-9, **LINE}
FIXED = {"method": "CG6g", "h": 1 / 32, **LINE}
OUTPUTS = {
    "ends": {}, "times": {"t_eval": [0.25, 0.5, 1.0]}, "dense": {"dense_output": True},
}  # fmt: skip


def members_alone(f, span, y0, parameters=(None, None), **options):
    """Return each member's own solution, at the ends of the span unless times are wanted."""
    options = {"t_eval": span} | options
    pairs = zip(y0, parameters, strict=True)
    return [cg.solve_ivp(f, span, point, parameters=row, **options) for point, row in pairs]


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("options", [CHOSEN, FIXED], ids=["chosen", "fixed"])
def test_a_member_that_fails_ends_alone(options, output, compiled_function):
    rates = np.stack([RATES, [NEVER, NEVER, NEVER, 0.6]], axis=-1)
    f = compiled_function("decays")
    with pytest.warns(UserWarning, match=r"Failure of 1 of 4 trajectories; of y0\[3\]") as warned:
        solution = cg.solve_ensemble(
            f, (0, 1), [1.0], parameters=rates, **options, **OUTPUTS[output]
        )
    assert [(str(w.message), w.filename) for w in warned] == [(solution.message, __file__)]
    assert solution.status.tolist() == [0, 0, 0, -1]
    assert not solution.success
    assert list(solution.messages) == [3]
    assert re.match(r"f returned the error code 5 at t = 0\.[6-9]", solution.messages[3])
    assert solution.message == f"Failure of 1 of 4 trajectories; of y0[3]: {solution.messages[3]}."
    assert solution[3].message == f"Failure: {solution.messages[3]}."
    assert 0.3 < solution.t_end[3] <= 0.65
    there = solution.t <= solution.t_end[3]
    assert (solution.y[there, 3] == 1.0).all()  # its rate is zero
    assert np.isnan(solution.y[~there, 3]).all()
    assert solution[3].t.tolist() == solution.t[there].tolist()
    apart = members_alone(f, (0, 1), np.ones((3, 1)), rates[:3], **options, **OUTPUTS[output])
    for i, alone in enumerate(apart):
        np.testing.assert_array_equal(solution.y[:, i], alone.y[-len(solution.t) :])
        assert solution.nfev[i] == alone.nfev
    if solution.sol is not None:
        assert np.isnan(solution.sol(0.9)[3, 0])
        np.testing.assert_allclose(solution.sol(0.9)[:3, 0], np.exp(0.9 * RATES[:3]), rtol=1e-10)


@pytest.mark.parametrize(("name", "good", "bad", "options", "message"), [
    ("square", 0.0, 4.0, {}, "the step size fell below"),
    ("square", 0.0, 1e160, {}, "f must return finite numbers"),
    ("stops", 0.0, 1.0, {}, "f returned the error code 7 at t = 0"),
    ("growth", 1.0, 0.0, {"max_steps": 3}, "3 steps (max_steps)"),
    ("growth", 1.0, 1e308, {"method": "CG3", "h": 0.5}, "a stage is no longer finite"),
])  # fmt: skip
@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.filterwarnings("ignore:Failure of")
def test_failures_are_named(name, good, bad, options, message, output, compiled_function):
    span = (0.0, 1.0) if "h" in options else (0.0, 0.5)
    solution = cg.solve_ensemble(
        compiled_function(name), span, [[good], [bad], [good]],
        **{**LINE, **options, **OUTPUTS[output], "t_eval": [0.0, span[1]]},
    )  # fmt: skip
    assert list(solution.messages) == [1]
    assert solution.messages[1].startswith(message)
    assert solution.message.startswith("Failure of 1 of 3 trajectories; of y0[1]: ")
    assert np.isnan(solution.y).ravel().tolist() == [False] * 4 + [True, False]


def test_points_too_large_for_the_solution_within(compiled_function):
    options = {"t_eval": [0.5], "rtol": 1e-3, **LINE}
    y0 = np.array([[1.0], [1e308]])
    solution = cg.solve_ensemble(compiled_function("growth"), (0, 0.58), y0, **options)
    for member, alone in zip(
        solution, members_alone(compiled_function("growth"), (0, 0.58), y0, **options), strict=True
    ):
        np.testing.assert_array_equal(member.y, alone.y)
        assert (member.status, member.message) == (alone.status, alone.message)
    assert math.isclose(solution.y[0, 0, 0], math.exp(0.5), rel_tol=5e-11)


@pytest.mark.parametrize("kind", ["compiled", "python", "vectorized"])
def test_progress_is_the_sum_over_members(kind, compiled_function, monkeypatch):
    monkeypatch.setattr(drive, "_REPORT_SECONDS", 0.0)
    monkeypatch.setattr(drive, "_SECONDS", 0.0)
    reports = []
    cg.solve_ensemble(
        compiled_function("growth") if kind == "compiled" else lambda t, y: y,
        (0, 2), np.ones((5, 1)),
        vectorized=kind == "vectorized", progress=lambda *now: reports.append(now), **CHOSEN,
    )  # fmt: skip
    done, total = zip(*reports, strict=True)
    assert set(total) == {10.0}
    assert all(a <= b for a, b in itertools.pairwise(done))
    assert done[-1] == 10.0
    assert len({x for x in done if 0 < x < 4}) > 3


def test_a_compiled_function_that_writes_into_its_point(compiled_function):
    """It receives a copy, so that the result does not change."""
    for options in (
        {"method": "CG5a", "h": 0.01},
        {"rtol": 1e-10, "atol": 1e-10, "t_eval": [1.0]},
        {"method": "DICG6", "h": 0.01},
        {"method": "CF6a", "h": 0.01},  # whose flows go on from stages
        {"method": "CF5r", "h": 0.01},  # in two registers
        {"method": "RKMK5(4)", "h": 0.01},
    ):
        solution = cg.solve_ensemble(
            compiled_function("overwrites"), (0, 1), [[1.0], [1.0]], **LINE, **options
        )
        np.testing.assert_allclose(solution.y[-1], np.full((2, 1), np.exp(-1.0)), rtol=5e-11)


@pytest.mark.parametrize("which", [min, max])
@pytest.mark.filterwarnings("ignore:Failure of")
def test_functions_that_fail_between_steps(which):
    """Evaluations for output are not evaluations of steps."""
    signature = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, DOUBLES, DOUBLES, ctypes.c_void_p)
    options = {"method": "CG4(3)", **LINE}
    expected = {"t_eval": [0.31, 0.72], **options}

    def growth(times, bad=()):
        def called(t, y, f, data):
            times.add(t)
            f[0] = y[0]
            return 9 if t in bad and y[0] > 3.0 else 0

        return signature(called)

    steps, both, y0 = set(), set(), np.array([[1.0], [3.5], [1.5]])
    cg.solve_ivp(growth(steps), (0, 1), y0[1], **options)
    cg.solve_ivp(growth(both), (0, 1), y0[1], **expected)
    solution = cg.solve_ensemble(growth(set(), {which(both - steps)}), (0, 1), y0, **expected)
    assert list(solution.messages) == [1]
    assert solution.messages[1].startswith("f returned the error code 9 at t = 0.")
    assert np.isnan(solution.y[-1, 1]).all()
    for i in (0, 2):
        alone = cg.solve_ivp(growth(set()), (0, 1), y0[i], **expected)
        np.testing.assert_array_equal(solution.y[:, i], alone.y)


@pytest.mark.filterwarnings("ignore:Failure of")
def test_steps_without_an_interpolant_are_not_counted():
    f = lambda t, y: [np.nan if 0.401 < t < 0.449 or 0.451 < t < 0.499 else 1.0]
    options = {"frame": Euclidean(1), "method": "RKMK4", "h": 0.1, "dense_output": True}
    run = cg.solve_ensemble(f, (0, 1), [[0.0]], **options)
    assert (run.steps.tolist(), run.t_end.tolist()) == ([4], [0.4])


@pytest.mark.filterwarnings("ignore:Failure of")
def test_residuals_of_other_members_are_not_named():
    f = lambda t, y: [-300 * np.sin(y[0]) if 0 < y[0] < 20 else 1.0]
    options = {"frame": Euclidean(1), "method": "ImplicitMidpoint", "h": 0.1}
    options["stage_solver"] = "fixed-point"
    for points in ([[1.0], [50.0]], [[50.0], [1.0]]):
        (message,) = cg.solve_ensemble(f, (0, 1), points, **options).messages.values()
        assert "did not converge" in message
        assert "residual" not in message
    with pytest.raises(cg.ConvergenceError, match="the residual is 261"):
        cg.integrate(f, (0, 1), [1.0], **options)


def test_compiled_events_name_the_time_when_they_fail():
    def value(t, y, data):
        return math.nan if t < 0.5 and y[0] < 2.0 else 1.0

    event = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, DOUBLES, ctypes.c_void_p)(value)
    options = {"frame": Euclidean(1), "h": 0.1, "method": "CF4"}
    for events in (event, lambda t, y: value(t, y, None)):
        with pytest.raises(ValueError, match=r"events.* must return finite .* at t = 0\.(4|39)"):
            cg.solve_ensemble(lambda t, y: [0.0], (1, 0), [[1.0], [50.0]], events=events, **options)
