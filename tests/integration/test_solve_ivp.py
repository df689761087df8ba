"""solve_ivp: SciPy's conventions, its bad inputs, and agreement with SciPy on flat space."""

import copy
import pickle
import sys

import numpy as np
import pytest
import scipy.integrate

import cg
from cg.frames import SO3, Euclidean
from cg.integration import DenseOutput, Solution
from cg.method.tableau import Tableau
from cg.problems import StateDependentRotation

pytestmark = pytest.mark.sanitize

PROBLEM = StateDependentRotation()
SCIPY_FIELDS = ("t", "y", "sol", "t_events", "y_events", "nfev", "njev", "nlu", "status")


def solve(f=PROBLEM.f, t_span=(0.0, 1.0), y0=None, **options):
    options = {"frame": SO3()} | options
    return cg.solve_ivp(f, t_span, np.eye(3) if y0 is None else y0, **options)


def orbit(t, y):
    """Two bodies, one fixed."""
    cubed = np.hypot(y[0], y[1]) ** 3
    return np.array([y[2], y[3], -y[0] / cubed, -y[1] / cubed])


def oscillator(t, y, mu=1.5):
    return np.array([y[1], mu * (1 - y[0] ** 2) * y[1] - y[0] + 0.3 * np.cos(t)])


@pytest.mark.parametrize(
    ("f", "y0", "stop", "method"),
    [
        (orbit, [1.0, 0.0, 0.0, 1.1], 6.0, "CG4(3)"),
        (orbit, [1.0, 0.0, 0.0, 1.1], 6.0, "auto"),
        (oscillator, [1.0, 0.5], 8.0, "CG4(3)"),
        # From 8 back to 0 with 1e-4 SciPy's RK45, whose steps these are, ends in infinity.
        (oscillator, [1.0, 0.5], 5.0, "auto"),
    ],
)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("backward", [False, True])
def test_agrees_with_scipy_on_flat_space(f, y0, stop, method, tolerance, backward):
    if backward:
        first = scipy.integrate.solve_ivp(f, (0, stop), y0, method="DOP853", rtol=1e-13, atol=1e-13)
        y0 = first.y[:, -1]
    span = (stop, 0.0) if backward else (0.0, stop)
    times = np.linspace(*span, 23)
    options = {"t_eval": times, "rtol": tolerance, "atol": tolerance, "dense_output": True}
    ours = cg.solve_ivp(f, span, y0, frame=Euclidean(len(y0)), method=method, **options)
    theirs = scipy.integrate.solve_ivp(f, span, y0, method="RK23", **options)
    truth = scipy.integrate.solve_ivp(
        f, span, y0, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-13
    )
    error = np.abs(ours.y - truth.y.T).max()
    assert error < 3 * np.abs(theirs.y - truth.y).max() + 1e-12
    assert error > 0.0
    np.testing.assert_array_equal(ours.t, times)
    np.testing.assert_allclose(ours.sol(times), ours.y, rtol=0, atol=1e-14)
    for name in SCIPY_FIELDS:
        assert hasattr(theirs, name)
        assert hasattr(ours, name)
    assert (ours.status, ours.success, theirs.success) == (0, True, True)


def test_default_output_is_that_of_the_steps_with_time_first():
    solution = solve()
    assert isinstance(solution, Solution)
    assert solution.t[0] == 0.0
    assert solution.t[-1] == 1.0
    assert (np.diff(solution.t) > 0).all()
    assert solution.y.shape == (solution.steps + 1, 3, 3)
    assert solution.sol is None
    assert solution.t_events is None
    assert solution.y_events is None
    assert (solution.njev, solution.nlu, solution.status) == (0, 0, 0)
    assert "end of t_span" in solution.message
    assert SO3().membership_error(solution.y).max() < 1e-14
    for array in (solution.t, solution.y):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    with pytest.raises(AttributeError):
        solution.status = 1


def test_fixed_steps_are_those_of_integrate():
    ours = solve(method="CG4a", h=0.3)
    theirs = cg.integrate(PROBLEM.f, (0.0, 1.0), np.eye(3), frame=SO3(), method="CG4a", h=0.3)
    np.testing.assert_array_equal(ours.t, theirs.t)
    np.testing.assert_array_equal(ours.y, theirs.y)
    assert (ours.nfev, ours.nexp, ours.steps) == (theirs.nfev, theirs.nexp, 4)
    assert ours.nrejected == 0


def test_t_eval_does_not_change_the_steps():
    free = solve(method="CG4a", h=0.25, dense_output=True)
    times = np.array([0.0, 0.1, 0.25, 0.3, 0.31, 0.9, 1.0])
    solution = solve(method="CG4a", h=0.25, t_eval=times)
    np.testing.assert_array_equal(solution.t, times)
    np.testing.assert_array_equal(solution.y, free.sol(times))
    np.testing.assert_array_equal(solution.y[2], free.y[1])
    assert solution.steps == 4
    assert SO3().membership_error(solution.y).max() < 1e-14


def test_t_eval_at_steps_needs_no_continuous_solution():
    plain = solve(method="CG4a", h=0.25)
    chosen = solve(method="CG4a", h=0.25, t_eval=[0.25, 0.75])
    np.testing.assert_array_equal(chosen.y, plain.y[[1, 3]])
    assert (chosen.nfev, chosen.nexp) == (plain.nfev, plain.nexp)


def test_t_eval_may_be_empty():
    solution = solve(t_eval=[])
    assert solution.t.shape == (0,)
    assert solution.y.shape == (0, 3, 3)
    assert "Solution" in repr(solution)


def test_empty_span_is_the_initial_point():
    for options in ({}, {"h": 0.1}):
        solution = solve(t_span=(2.0, 2.0), dense_output=True, **options)
        np.testing.assert_array_equal(solution.t, [2.0])
        np.testing.assert_array_equal(solution.y, [np.eye(3)])
        np.testing.assert_array_equal(solution.sol(2.0), np.eye(3))
        assert (solution.nfev, solution.steps, solution.success) == (0, 0, True)


def test_args_reach_f_and_events():
    seen = []

    def f(t, y, factor, shift):
        return factor * PROBLEM.f(t, y) + shift

    def event(t, y, factor, shift):
        seen.append((factor, shift))
        return t - 0.5

    solution = solve(f, args=(2.0, 0.25), events=event)
    plain = solve(lambda t, y: 2.0 * PROBLEM.f(t, y) + 0.25)
    np.testing.assert_array_equal(solution.y, plain.y)
    assert set(seen) == {(2.0, 0.25)}


def test_too_many_steps_end_without_success_and_keep_what_was_accepted():
    options = {"max_step": 0.01, "max_steps": 20, "dense_output": True}
    message = "max_steps = 20 steps, rejected ones included, led only to t = 0."
    solution = solve(**options)
    assert (solution.status, solution.success) == (-1, False)
    assert message in solution.message
    assert solution.steps + solution.nrejected == 20
    assert len(solution.t) == solution.steps + 1
    np.testing.assert_array_equal(solution.sol(solution.t), solution.y)
    ensemble = cg.solve_ensemble(PROBLEM.f, (0, 1), [np.eye(3)] * 2, frame=SO3(), **options)
    for member in (0, 1):
        assert message in ensemble.messages[member]
        assert (ensemble[member].status, ensemble[member].success) == (-1, False)
        assert (ensemble.steps + ensemble.nrejected)[member] == 20
        np.testing.assert_array_equal(ensemble.sol[member].ts, solution.t)
        np.testing.assert_array_equal(ensemble.sol[member](solution.t), solution.y)
    free = solve(rtol=1e-8)
    assert solve(rtol=1e-8, max_steps=free.steps + free.nrejected).success
    assert not solve(rtol=1e-8, max_steps=free.steps + free.nrejected - 1).success


def test_steps_without_end_are_given_up(monkeypatch):
    monkeypatch.setattr(sys.modules["cg.integration.arguments"], "DEFAULT_MAX_STEPS", 50)
    for options in ({"max_step": 1e-30}, {"t_span": (0.0, 1e300), "max_step": 1.0}):
        solution = solve(**options)
        assert "max_steps = 50 steps" in solution.message
        assert solution.steps + solution.nrejected == 50


def test_results_are_compared_by_identity():
    solution, other = solve(), solve()
    assert solution == solution
    assert solution != other
    run = cg.integrate(PROBLEM.f, (0, 1), np.eye(3), frame=SO3(), method="CG3", h=0.5)
    assert run != copy.copy(run)


@pytest.mark.parametrize("t", ["a", 1j, [0.1, "b"]])
def test_times_of_a_continuous_solution_are_named(t):
    with pytest.raises(ValueError, match="t must be an array of real numbers, got"):
        solve(dense_output=True).sol(t)


def test_a_mask_that_hides_nothing_is_no_matter():
    solution = solve(y0=np.ma.masked_array(np.eye(3)))
    np.testing.assert_array_equal(solution.y, solve().y)


def never(t, y):
    raise AssertionError("f was called although the arguments are bad")


HALVES = Tableau([["1/2"]], ["1"])


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"f": 3}, TypeError, "f must be callable"),
        ({"frame": "SO3"}, TypeError, "frame must be a Frame"),
        ({"method": "RK45"}, ValueError, r"method must be one of .*got 'RK45'; .*DP5\(4\) has its"),
        ({"method": "RK23"}, ValueError, r"got 'RK23'; .*BS3\(2\) has its"),
        ({"method": "LSODA"}, ValueError, "got 'LSODA'; .*RadauIIA5"),
        ({"method": "DOP835"}, ValueError, "got 'DOP835'; similar names are DOP853"),
        ({"method": "rkmk5"}, ValueError, r"got 'rkmk5'; similar names are .*RKMK5\(4\)"),
        ({"method": "CG4a"}, ValueError, "method must be a pair unless h .*'CG4a'"),
        ({"method": HALVES, "h": 0.1, "stage_solver": "hope"}, ValueError, "stage_solver must"),
        ({"t_span": (0.0, 1.0, 2.0)}, ValueError, "t_span must be two numbers"),
        ({"t_span": (0.0, np.inf)}, ValueError, "t_span must be finite"),
        ({"y0": np.eye(2)}, ValueError, r"y0 must have shape \(3, 3\), got \(2, 2\)"),
        ({"y0": 1.01 * np.eye(3)}, ValueError, "distance from the manifold is 0.01"),
        ({"y0": np.full((3, 3), np.nan)}, ValueError, "y0 must be finite"),
        ({"y0": 1j * np.eye(3)}, ValueError, "y0 must be an array of real numbers"),
        ({"y0": [[1.0], [2.0, 3.0]]}, ValueError, "y0 must be an array of real numbers"),
        ({"y0": np.stack([np.eye(3)] * 2)}, ValueError, "y0 must .*cg.solve_ensemble"),
        ({"rtol": -1e-3}, ValueError, "rtol must be finite and not negative, got -0.001"),
        ({"rtol": np.nan}, ValueError, "rtol must be finite"),
        ({"rtol": "low"}, TypeError, "rtol must be a real number"),
        ({"atol": -1.0}, ValueError, "atol must be finite and not negative"),
        ({"atol": [1e-6, 1e-6]}, ValueError, r"atol must be a number or have shape \(3,\)"),
        ({"atol": "low"}, ValueError, "atol must be an array of real numbers"),
        ({"h": 0.0}, ValueError, "h must be positive and finite"),
        ({"h": "0.1"}, TypeError, "h must be a real number"),
        ({"h": 0.1, "rtol": 1e-3}, ValueError, "rtol must not be given together with h"),
        ({"h": 0.1, "atol": 1e-3}, ValueError, "atol must not be given together with h"),
        ({"h": 0.1, "first_step": 0.1}, ValueError, "first_step must not be given together"),
        ({"h": 0.1, "max_step": 0.05}, ValueError, "h must not be larger than max_step = 0.05"),
        ({"max_step": 0.0}, ValueError, "max_step must be positive, got 0.0"),
        ({"max_step": np.nan}, ValueError, "max_step must be positive"),
        ({"max_steps": 0}, ValueError, "max_steps must be at least 1, got 0"),
        ({"max_steps": 1e3}, TypeError, "max_steps must be an integer, got 1000.0"),
        ({"h": 0.1, "max_steps": 3}, ValueError, "max_steps must not be given together with h"),
        ({"h": 1e-9}, ValueError, r"h is too small for t_span: 1000000000 steps need .* GiB"),
        (
            {"h": 1e-9, "t_eval": [0.5], "dense_output": True},
            ValueError,
            r"h is too small for t_span: 1000000000 steps need .* got 1e-09",
        ),
        ({"y0": np.ma.masked_equal(np.eye(3), 1)}, ValueError, "y0 must be .* got masked_array"),
        ({"max_step": "small"}, TypeError, "max_step must be a real number"),
        ({"first_step": 0.0}, ValueError, "first_step must be positive"),
        ({"first_step": -0.1}, ValueError, "first_step must be positive"),
        ({"first_step": 2.0}, ValueError, "first_step must not exceed the length of t_span"),
        ({"t_eval": [0.1, 2.0]}, ValueError, "t_eval must lie within t_span, 0 to 1"),
        ({"t_eval": [-0.1]}, ValueError, "t_eval must lie within t_span"),
        ({"t_eval": [np.nan]}, ValueError, "t_eval must lie within t_span"),
        ({"t_eval": [0.5, 0.4]}, ValueError, "t_eval must be strictly sorted"),
        ({"t_eval": [0.5, 0.5]}, ValueError, "t_eval must be strictly sorted"),
        (
            {"t_span": (1.0, 0.0), "t_eval": [0.4, 0.5]},
            ValueError,
            "t_eval must be strictly sorted in the direction of integration",
        ),
        ({"t_eval": [[0.5]]}, ValueError, "t_eval must have one axis"),
        ({"args": 3}, TypeError, r"args must be a tuple .*\(x,\) for one, got 3"),
        ({"events": 3}, TypeError, "events must be a function or a sequence"),
        ({"events": [3]}, TypeError, r"events\[0\] must be callable"),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused_before_any_work(changes, error, message):
    with pytest.raises(error, match=message):
        solve(**({"f": never} | changes))


@pytest.mark.parametrize(
    ("y0", "message"),
    [
        (np.zeros((0, 3, 3)), "y0 must hold at least one point"),
        ([np.eye(3), 1.1 * np.eye(3)], r"y0\[1\] must be a point of .* 0.1"),
        ([np.eye(3), np.full((3, 3), np.inf)], r"y0\[1\] must be finite"),
    ],
)
def test_bad_points_of_ensembles_are_refused_before_any_work(y0, message):
    for options in ({}, {"h": 0.1}):
        with pytest.raises(ValueError, match=message):
            cg.solve_ensemble(never, (0.0, 1.0), y0, frame=SO3(), **options)


def test_a_first_step_may_be_as_long_as_the_span():
    for span in ((0.0, 1.0), (-1.0, 1.0), (2.0, -1.0)):
        length = abs(span[1] - span[0])
        solution = solve(lambda t, y: [1e-3, 0.0, 0.0], t_span=span, first_step=length)
        assert solution.steps == 1
        with pytest.raises(ValueError, match="first_step must not exceed the length of t_span"):
            solve(never, t_span=span, first_step=np.nextafter(length, 9.0))


def test_warnings_name_the_line_of_the_call():
    poor = Tableau([["0"], ["1/2", "0"]], ["1/2", "1/4"], name="poor")
    with pytest.warns(UserWarning, match="poor has order 0") as caught:
        cg.solve_ivp(PROBLEM.f, (0, 1), np.eye(3), frame=SO3(), method=poor, h=0.5)
    assert caught[0].filename == __file__


def test_rtol_below_rounding_is_raised_with_a_warning():
    with pytest.warns(UserWarning, match="rtol = 1e-20 is too small") as caught:
        solve(t_span=(0.0, 1e-3), rtol=1e-20, atol=1e-6)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("options", [{}, {"h": 0.1}])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1.0, np.nan, 0.0], r"f must return finite numbers, got .*nan"),
        ([1.0, 2.0], r"f must return an array of shape \(3,\), got shape \(2,\)"),
        ("north", "f must return 3 real numbers, got .north."),
    ],
)
def test_bad_values_of_f_end_the_call(value, message, options):
    with pytest.raises(ValueError, match=message):
        solve(lambda t, y: value if t > 0.3 else [1.0, 0.0, 0.0], **options)


@pytest.mark.parametrize("options", [{}, {"h": 0.1}])
@pytest.mark.parametrize("kind", [OverflowError, ArithmeticError, KeyError, RuntimeError])
def test_exceptions_of_f_pass_through(kind, options):
    def f(t, y):
        if t > 0.3:
            raise kind("at last")
        return PROBLEM.f(t, y)

    with pytest.raises(kind, match="at last"):
        solve(f, **options)


def test_f_may_not_change_the_point_nor_keep_its_buffer():
    buffer = np.empty(3)

    def f(t, y):
        assert not y.flags.writeable
        buffer[:] = PROBLEM.f(t, y)
        return buffer

    np.testing.assert_array_equal(solve(f, dense_output=True).y, solve(dense_output=True).y)


def test_dense_output_is_told_by_its_kind():
    solution = solve(dense_output=True)
    assert isinstance(solution.sol, DenseOutput)
    np.testing.assert_array_equal(solution.sol.ts, solution.t)


@pytest.mark.parametrize(
    "argument",
    [
        {"t_span": (0, 10**400)},
        {"t_span": ("0", "1")},
        {"h": 10**400},
        {"y0": [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]]},
        {"rtol": 10**400},
        {"atol": 10**400},
        {"first_step": 10**400},
    ],
)
def test_numbers_beyond_doubles_are_refused_by_name(argument):
    with pytest.raises(ValueError, match=f"{next(iter(argument))} must be"):
        solve(**argument)


def test_a_solution_can_be_copied_and_pickled():
    solution = solve(dense_output=True)
    for same in (copy.deepcopy(solution), pickle.loads(pickle.dumps(solution))):
        for array in (same.t, same.y, same.sol.ts):
            assert not array.flags.writeable
        assert (same.sol([0.1, 0.7]) == solution.sol([0.1, 0.7])).all()


def test_a_first_step_that_would_underflow():
    assert solve(t_span=(0.0, 1e-320)).t[-1] == 1e-320
    assert solve(max_step=10**400).success


@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
@pytest.mark.filterwarnings("ignore:invalid:RuntimeWarning")
def test_a_right_hand_side_too_large_for_any_step():
    with pytest.raises(OverflowError, match="f is too large to choose a step at t = 0"):
        solve(f=lambda t, y: np.full(3, 1e308))


def test_copies_of_solutions_are_read_only():
    run = cg.integrate(PROBLEM.f, (0, 1), np.eye(3), frame=SO3(), method="CG3", h=0.5)
    for same in (copy.copy(run), copy.deepcopy(run), pickle.loads(pickle.dumps(run))):
        np.testing.assert_array_equal(same.y, run.y)
        assert not same.t.flags.writeable
        assert not same.y.flags.writeable
    out = np.zeros((2, 1, 3, 3))
    run = cg.solve_ensemble(PROBLEM.f, (0, 1), np.eye(3)[None], frame=SO3(), out=out)
    assert copy.copy(run).y is out
    assert copy.deepcopy(run).y.flags.writeable
    assert out.flags.writeable
