"""Right-hand sides that aren't finite beyond the edge of their domain."""

import ctypes

import numpy as np
import pytest
from refusals import refuses

import crouch_grossman as cg
from crouch_grossman.frames import Euclidean

LINE = {"frame": Euclidean(1)}
ADAPTIVE = ["auto", "CF5(4)", "RKMK5(4)", "DP5(4)", "DOP853", "CG5(4)", "RadauIIA5"]


def emptying(t, y):
    """A tank that empties, y = (1 - t/2)^2; NaN where y is negative."""
    with np.errstate(invalid="ignore"):
        return -np.sqrt(y)


def low(t, y):
    return y[0] - 0.01


low.terminal = True


def clock(t, y, *rows):
    """f is NaN after t = 1, of an ensemble in the member whose row is 1 only."""
    bad = (np.asarray(t) > 1) & (rows[0][..., 0] == 1 if rows else True)
    return np.where(bad, np.nan, 1.0)[..., None]


@pytest.mark.parametrize("method", ADAPTIVE)
def test_end_at_the_edge(method):
    solution = cg.solve_ivp(clock, (0, 5), [0.0], method=method, **LINE)
    assert solution.status == -1
    assert abs(solution.t[-1] - 1) < 1e-14
    assert "f must return finite numbers" in solution.message
    assert "t = 0.99999" in solution.message or "t = 1" in solution.message
    np.testing.assert_allclose(solution.y[:, 0], solution.t, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("method", ["CF4", "DP5(4)", "ImplicitMidpoint", "RadauIIA5"])
def test_fixed_steps(method):
    solution = cg.solve_ivp(clock, (0, 5), [0.0], method=method, h=0.3, **LINE)
    assert solution.status == -1
    assert 0.6 < solution.t[-1] < 1.0
    assert "f must return finite numbers at t = " in solution.message
    with pytest.raises(ValueError, match=r"f must return finite numbers.* at t = 2"):
        cg.solve_ivp(clock, (2, 5), [0.0], method=method, h=0.3, **LINE)


@pytest.mark.parametrize("vectorized", [False, True])
def test_first_bad_stage_of_linear_equations(vectorized):
    options = {"method": "CFM6(4)b", "h": 3.0, "vectorized": vectorized} | LINE
    run = cg.solve_linear(lambda t: clock(t, None), (0, 6), [0.0], **options)
    assert "at t = 1.5" in run.message


@pytest.mark.parametrize("kind", [{}, {"vectorized": True}, {"common_steps": True}, {"workers": 2},
                                  {"vectorized": True, "common_steps": True}], ids=str)  # fmt: skip
@pytest.mark.parametrize("method", ["auto", "CF5(4)", "RadauIIA5"])
@pytest.mark.filterwarnings("ignore:Failure of 1 of 4")
def test_members(kind, method):
    rows = np.array([[0.0], [0.0], [1.0], [0.0]])
    solution = cg.solve_ensemble(clock, (0, 5), [0.0], parameters=rows, method=method, **kind,
                                 **LINE)  # fmt: skip
    assert list(solution.messages) == [2]
    assert "f must return finite numbers" in solution.messages[2]
    assert abs(solution.t_end[2] - 1) < 1e-14
    np.testing.assert_allclose(solution.y[-1, [0, 1, 3], 0], 5.0, rtol=1e-14)
    with pytest.raises(KeyError, match="mine"):  # exceptions end the call
        cg.solve_ensemble(raising, (0, 5), [0.0], parameters=rows, method=method, **kind, **LINE)


def raising(t, y, rows):
    if np.any(np.asarray(t) > 1):
        raise KeyError("mine")
    return clock(0 * t, y, rows)


def test_stepper():
    stepper = cg.Stepper(emptying, 0.0, [1.0], 5.0, **LINE)
    while stepper.status == "running" and stepper.y[0] > 0.01:
        assert stepper.step() is None
    assert abs(stepper.y[0] - (1 - stepper.t / 2) ** 2) < 2e-6
    stepper = cg.Stepper(clock, 0.0, [0.0], 5.0, **LINE)
    assert "f must return finite numbers" in stepper.advance(3.0)
    assert stepper.status == "failed"
    assert abs(stepper.t - 1) < 1e-14
    refuses(RuntimeError, "has failed", stepper.step)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("derivatives", [None, "forward"])
def test_compiled(value, derivatives):
    @ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_double, ctypes.POINTER(ctypes.c_double),
        ctypes.POINTER(ctypes.c_double), ctypes.c_void_p,
    )  # fmt: skip
    def f(t, y, out, data):
        out[0] = -(y[0] ** 0.5) if y[0] >= 0 else value
        return 0

    options = {"rtol": 1e-8, "atol": 1e-8, "derivatives": derivatives} | LINE
    solution = cg.solve_ivp(f, (0, 5), [1.0], events=low, **options)
    assert abs(solution.t_events[0][0] - 1.8) < 1e-8
    refuses(ValueError, "f must return finite numbers", cg.solve_ivp, f, (0, 5), [-1.0], **options)


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("method", ["CF5(4)", "RKMK8(5,3)", "DOP853"])
@pytest.mark.parametrize("sign", [1, -1])
def test_between_common_steps(method, sign, vectorized):
    """f is NaN for one member within the step, where its interpolant alone evaluates it."""
    asked, bad = [], [np.inf]

    def f(t, y, row):
        asked.extend(np.unique(t))
        value = np.cos(3.0 * np.asarray(t))[..., None] * np.ones_like(y)
        return np.where(
            (np.abs(np.asarray(t)[..., None] - bad[0]) < 1e-12) & (row == 1), np.nan, value
        )

    def solve(**options):
        asked.clear()
        solution = cg.solve_ensemble(
            f, (0, 4 * sign), [0.0], parameters=[[0.0], [1.0], [0.0]], method=method, rtol=1e-6,
            common_steps=True, vectorized=vectorized, **options, **LINE
        )  # fmt: skip
        return solution, set(asked)

    output = {"t_eval": sign * np.linspace(0, 4, 50)}
    between = sorted(solve(**output)[1] - solve()[1])
    assert len(between) > 3
    for bad[0] in (between[len(between) // 2], between[len(between) // 2 + 1]):
        for options in (output, {"dense_output": True}, {"events": lambda t, y, row: y[0] - 0.1}):
            solution, _ = solve(**options)
            assert not solution.messages
            last = np.sin(12.0 * sign) / 3.0
            np.testing.assert_allclose(solution.y[-1, :, 0], last, rtol=5e-7)


@pytest.mark.parametrize("begin", [0.0, 0.5])
def test_messages_are_the_same_with_derivatives(begin):
    def f(t, y):
        return [np.nan if t >= begin else 1.0]

    def outcome(**options):
        try:
            return cg.solve_ivp(f, (0, 1), [0.0], h=0.25, method="CF5(4)", **LINE, **options)
        except ValueError as error:
            return str(error)

    plain, derived = outcome(), outcome(derivatives="forward")
    if begin == 0.0:
        assert derived == "f must return finite numbers at t = 0"
        assert plain == "f must return finite numbers, got array([nan]) at t = 0"
    else:
        assert derived.message == plain.message
    adaptive = cg.solve_ivp(f, (0, 1), [0.0], derivatives="forward", **LINE) if begin else None
    assert adaptive is None or "f must return finite numbers next to" in adaptive.message


def test_each_member_names_what_failed():
    with pytest.warns(UserWarning, match="Failure of 2 of 2"):
        solution = cg.solve_ensemble(
            lambda t, y, p: [np.nan if t >= 0.5 and p[0] == 0.0 else 0.0], (0, 1), [0.0],
            parameters=[[0.0], [3000.0]], derivatives="forward", h=0.25, method="CF5(4)",
            jac=lambda t, y, p: [[p[0]]], df_dp=lambda t, y, p: [[1e300]], **LINE,
        )  # fmt: skip
    assert solution.messages[0].startswith("f must return finite numbers")
    assert solution.messages[1].startswith("derivatives of the solution exceed the range")
