"""solve_ivp: SciPy's conventions, its bad inputs, and agreement with SciPy on flat space."""

import copy
import pickle
import sys

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.frames import SO3, Euclidean
from cg.problems import StateDependentRotation

pytestmark = pytest.mark.sanitize

PROBLEM = StateDependentRotation()


def solve(f=PROBLEM.f, t_span=(0.0, 1.0), y0=None, **options):
    options = {"frame": SO3()} | options
    return cg.solve_ivp(f, t_span, np.eye(3) if y0 is None else y0, **options)


def test_default_output_is_that_of_the_steps_with_time_first():
    solution = solve(y0=(y0 := np.eye(3)))
    y0[:] = 0.0
    np.testing.assert_array_equal(solution.y[0], np.eye(3))
    assert (np.diff(solution.t) > 0).all()
    assert solution.y.shape == (solution.steps + 1, 3, 3)
    assert {solution.sol, solution.t_events, solution.y_events, solution.y_after} == {None}
    assert (solution.njev, solution.nlu, solution.status) == (0, 0, 0)
    assert "end of t_span" in solution.message
    for array in (solution.t, solution.y):
        refuses(ValueError, "read-only", array.__setitem__, 0, 0.0)
    refuses(AttributeError, "status", setattr, solution, "status", 1)


def test_steps_without_end_are_given_up(monkeypatch):
    monkeypatch.setattr(sys.modules["cg.integration.arguments"], "DEFAULT_MAX_STEPS", 50)
    for options in ({"max_step": 1e-30}, {"t_span": (0.0, 1e300), "max_step": 1.0}):
        solution = solve(**options)
        assert "50 steps (max_steps)" in solution.message
        assert solution.steps + solution.nrejected == 50


def test_rtol_below_rounding_is_raised_with_a_warning():
    with pytest.warns(UserWarning, match="rtol = 1e-20 is too small") as caught:
        solve(t_span=(0.0, 1e-3), rtol=1e-20, atol=1e-6)
    assert caught[0].filename == __file__


def test_f_may_not_change_the_point_nor_keep_its_buffer():
    buffer = np.empty(3)

    def f(t, y):
        assert not y.flags.writeable
        buffer[:] = PROBLEM.f(t, y)
        return buffer

    np.testing.assert_array_equal(solve(f, dense_output=True).y, solve(dense_output=True).y)


def test_a_first_step_that_would_underflow():
    assert solve(t_span=(0.0, 1e-320)).t[-1] == 1e-320
    assert solve(max_step=10**400).success


def test_copies_of_solutions_are_read_only():
    run = cg.integrate(PROBLEM.f, (0, 1), np.eye(3), frame=SO3(), method="CG3", h=0.5)
    assert run == run
    for same in (copy.copy(run), copy.deepcopy(run), pickle.loads(pickle.dumps(run))):
        assert same != run
        np.testing.assert_array_equal(same.y, run.y)
        assert not same.t.flags.writeable
        assert not same.y.flags.writeable
    out = np.zeros((2, 1, 3, 3))
    run = cg.solve_ensemble(PROBLEM.f, (0, 1), np.eye(3)[None], frame=SO3(), out=out)
    assert copy.copy(run).y is out
    assert copy.deepcopy(run).y.flags.writeable
    assert out.flags.writeable


@pytest.fixture(params=["Python", "C"])
def growth(request, compiled_function):
    """Return f with y' = y."""
    return compiled_function("growth") if request.param == "C" else lambda t, y: y


@pytest.mark.parametrize("options", [{}, {"method": "CG4a", "h": 0.1}])
def test_an_empty_span_is_the_initial_point(options, growth):
    options = {"frame": Euclidean(1), "dense_output": True, **options}
    for output in ({}, {"t_eval": [2.0]}):
        still = cg.solve_ivp(growth, (2, 2), [1.0], **options, **output)
        assert (still.t.tolist(), still.y.tolist(), still.sol(2.0)) == ([2.0], [[1.0]], 1.0)
        assert (still.nfev, still.nexp, still.steps, still.success) == (0, 0, 0, True)
    many = cg.solve_ensemble(growth, (2, 2), [[1.0], [3.0]], **options)
    assert (many.t.tolist(), many.nfev.tolist(), many.success) == ([2.0], [0, 0], True)
    np.testing.assert_array_equal(many.sol(2.0), [[1.0], [3.0]])


@pytest.mark.filterwarnings("ignore:Failure of")
def test_too_many_steps_end_without_success_and_keep_accepted_steps(growth):
    span, line = (0.0, 1.0), {"frame": Euclidean(1)}
    options = {"max_step": 0.01, "max_steps": 20, "dense_output": True, **line}
    message = "Failure: 20 steps (max_steps), rejected ones included, led only to t = 0."
    solution = cg.solve_ivp(growth, span, [1.0], **options)
    assert (solution.status, solution.success) == (-1, False)
    assert solution.message.startswith(message)
    assert solution.steps + solution.nrejected == 20
    assert len(solution.t) == solution.steps + 1
    np.testing.assert_array_equal(solution.sol(solution.t), solution.y)
    ensemble = cg.solve_ensemble(growth, span, [[1.0]] * 2, **options)
    for member in (0, 1):
        assert message.removeprefix("Failure: ") in ensemble.messages[member]
        assert (ensemble[member].status, ensemble[member].success) == (-1, False)
        assert (ensemble.steps + ensemble.nrejected)[member] == 20
        np.testing.assert_array_equal(ensemble.sol[member].ts, solution.t)
        np.testing.assert_array_equal(ensemble.sol[member](solution.t), solution.y)
    options = {"rtol": 1e-8, "method": "CG4(3)", **line}
    unlimited = cg.solve_ivp(growth, span, [1.0], **options)
    count = unlimited.steps + unlimited.nrejected
    for most, success in ((count, True), (count - 1, False)):
        options["max_steps"] = most
        assert cg.solve_ivp(growth, span, [1.0], **options).success is success
        together = cg.solve_ensemble(growth, span, [[1.0], [0.0]], **options)
        assert together.success is success
        assert np.isnan(together.y[-1, :, 0]).tolist() == [not success, False]


@pytest.mark.parametrize("method", ["auto", "CF5(4)", "CG5(4)", "DP5(4)", "RadauIIA5"])
def test_steps_of_the_largest_size_are_counted_once(method):
    """Rounding makes ends of steps differ from their sizes; checks of stiffness look on the way."""
    options = {"frame": Euclidean(1), "method": method, "max_step": 0.1}
    f = lambda t, y: [1.0]
    for end in (80.0, 1200.0)[: 1 + (method == "auto")]:
        most = round(end / 0.1) + 4
        run = cg.solve_ivp(f, (0, end), [0.0], max_steps=most, **options)
        assert run.success
        assert most - 6 < run.steps <= most
    single = cg.solve_ivp(f, (0, 80.0), [0.0], max_steps=400, **options)
    assert (single.success, single.steps + single.nrejected) == (False, 400)


def test_names_of_linear_equations_and_derivatives_are_other_defaults():
    def equal(one, other):
        assert np.array_equal(one.y, other.y)
        assert one.nfev == other.nfev

    span, y0, options = (0, 1), np.eye(3), {"frame": SO3(), "rtol": 1e-6}
    plain = cg.solve_ivp(lambda t, y: [t, 1.0, y[0, 0]], span, y0, dense_output=True, **options)
    names = "transition", "sensitivity", "covariance", "dt_events", "gradient", "jacobian"
    assert {getattr(plain, name) for name in names} == {None}
    assert plain.sol.transition(0.5) is plain.sol.covariance([0.5]) is None
    linear = cg.solve_ivp(lambda t: [t, 1.0, 0.0], span, y0, linear=True, **options)
    equal(linear, cg.solve_linear(lambda t: [t, 1.0, 0.0], span, y0, **options))
    assert linear.table.name.startswith("CFM")
    for kind in ("forward", "adjoint"):
        options["derivatives"] = kind
        one, other = (
            solve(lambda t, y: [t, 1.0, y[0, 0]], span, y0, **options)
            for solve in (cg.solve_ivp, cg.solve_variational)
        )
        equal(one, other)
        if kind == "adjoint":
            equal(one, plain)
            assert np.array_equal(one.jacobian().y0, other.jacobian().y0)
        else:
            assert np.array_equal(one.transition, other.transition)


EPOCH = 1.7e9  # seconds since 1970
STAMPS = EPOCH + np.array([0.0, 0.01, 0.02])


def rise(t, y, *_):
    return [1.0]


def advance(t):
    cg.Stepper(rise, EPOCH, [0.0], EPOCH + 0.05, frame=Euclidean(1)).advance(t)


@pytest.mark.parametrize(("call", "message"), [
    (lambda: cg.Samples(STAMPS[[0, 2, 1]], np.ones(3)), "got .*.01 after .*.02"),
    (lambda: cg.Samples(STAMPS[[0, 2, 2]], np.ones(3)), "got .*.02 after .*.02"),
    (lambda: solve_late(inputs=cg.Samples([0, EPOCH], [1, 1], "linear")), "0 to .*, got .*.05"),
    (lambda: solve_late(t_eval=[EPOCH, EPOCH + 0.06]), r"to .*\.05, got .*\.06 at \[1\]"),
    (lambda: solve_late(t_eval=[EPOCH + 0.02, EPOCH + 0.01]), r"got .*\.01 after .*\.02"),
    (lambda: solve_late(breakpoints=[EPOCH + 0.06]), r"to .*\.05, got .*\.06"),
    (lambda: solve_late(dense_output=True).sol(EPOCH + 0.06), r"and .*\.05, got .*\.06"),
    (lambda: advance(EPOCH + 0.06), r"between 17.* and .*\.05, got .*\.06"),
])  # fmt: skip
def test_messages_tell_times_apart(call, message):
    refuses(ValueError, message, call)


def solve_late(**options):
    return cg.solve_ivp(rise, (EPOCH, EPOCH + 0.05), [0.0], frame=Euclidean(1), **options)
