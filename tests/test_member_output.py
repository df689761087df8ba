"""Ensembles with output on the way: steps in compiled code, what is between for many at a time."""

import ctypes
import math

import numpy as np
import pytest
from compiled_examples import DOUBLES, PROBLEMS

import cg
from cg.frames import SU, Euclidean
from cg.integration import member_output, own_steps, progress
from cg.integration.python_rhs import StepTooLongError

COUNTS = ("steps", "nrejected", "nfev", "nexp")


def alone(f, span, y0, **options):
    """Return each member's own solution."""
    lead = np.ndim(y0) - len(options["frame"].point_shape)
    return {i: cg.solve_ivp(f, span, y0[i], **options) for i in np.ndindex(np.shape(y0)[:lead])}


def check(found, apart):
    for i, run in apart.items():
        np.testing.assert_array_equal(found.y[(slice(None), *i)], run.y)
    for count in COUNTS:
        assert getattr(found, count) == sum(getattr(run, count) for run in apart.values())
    assert (found.status, found.message) == (0, "The end of t_span was reached.")
    assert found.failures == {}


@pytest.fixture
def in_compiled_code(monkeypatch):
    """Refuse the way of each member through Python."""

    def refuse(*arguments):
        raise AssertionError

    monkeypatch.setattr(own_steps, "_integrate_alone", refuse)


@pytest.fixture
def by_itself(monkeypatch):
    """Return a list of the members that were integrated by themselves."""
    members = []
    true = own_steps._integrate_alone

    def spied(problem, member, *others):
        members.append(member)
        return true(problem, member, *others)

    monkeypatch.setattr(own_steps, "_integrate_alone", spied)
    return members


@pytest.mark.parametrize("method", ["CG4(3)", "DP5(4)", "RKMK8(5,3)", "CF6(5)", "DOP853"])
@pytest.mark.parametrize("name", ["product", "sphere", "SU2 body"])
@pytest.mark.parametrize("span", [(0.0, 1.5), (1.0, -1.0)])
def test_members_are_what_they_are_alone(name, method, span, affine, in_compiled_code):
    problem = PROBLEMS[name]
    f, _keep = affine(problem)
    y0 = problem.frame.random_point(np.random.default_rng(7), (2, 3))
    options = {"frame": problem.frame, "method": method, "rtol": 1e-5, "atol": 1e-5}
    between = np.linspace(*span, 9)
    for times in (between, between[2:5], between[[0, 1]]):
        found = cg.solve_ivp(f, span, y0, t_eval=times, **options)
        check(found, alone(f, span, y0, t_eval=times, **options))
        np.testing.assert_array_equal(found.t, times)
        assert not found.y.flags.writeable
        assert not found.t.flags.writeable
    for times in (None, between[1:3]):
        found = cg.solve_ivp(f, span, y0, t_eval=times, dense_output=True, **options)
        apart = alone(f, span, y0, t_eval=times, dense_output=True, **options)
        if times is not None:
            check(found, apart)
        steps = np.concatenate([run.sol.ts for run in apart.values()])
        assert set(found.sol.ts) == set(steps)
        where = np.append(np.linspace(*span, 23), steps)
        for i, run in apart.items():
            np.testing.assert_array_equal(found.sol(where)[:, *i], run.sol(where))


def test_times_that_are_ends_of_steps(function, in_compiled_code):
    """Nothing is evaluated within them."""
    f, y0 = function("growth"), np.array([[1.0], [2.0]])
    options = {"frame": Euclidean(1), "first_step": 0.25, "max_step": 0.25, "rtol": 1e-3}
    ends = cg.solve_ivp(f, (0, 1), y0, **options)
    there = cg.solve_ivp(f, (0, 1), y0, t_eval=[0.25, 0.5, 0.75], **options)
    assert (there.nfev, there.nexp) == (ends.nfev, ends.nexp)
    np.testing.assert_allclose(
        there.y[:, :, 0], np.exp([[0.25], [0.5], [0.75]]) * [1, 2], rtol=1e-4
    )


def test_complex_points(affine, in_compiled_code):
    f, _keep = affine(PROBLEMS["SU2 space"])  # whose points are the same numbers
    y0 = SU(2).random_point(np.random.default_rng(1), (3,))
    options = {"frame": SU(2), "rtol": 1e-7, "t_eval": [0.1, 0.5], "dense_output": True}
    found = cg.solve_ivp(f, (0, 1), y0, **options)
    assert found.y.dtype == found.sol(0.3).dtype == complex
    check(found, alone(f, (0, 1), y0, **options))


@pytest.mark.parametrize("members", [1, 3, 1000])
@pytest.mark.parametrize("steps", [1, 7, 100])
@pytest.mark.parametrize("enough", [1, 10])
def test_pieces_change_nothing(members, steps, enough, function, monkeypatch, in_compiled_code):
    rates = np.linspace(-3, 3, 10)
    options = {
        "frame": Euclidean(1), "rtol": 1e-9, "atol": 1e-9, "dense_output": True,
        "parameters": np.stack([rates, np.full(10, 1e9)], axis=-1),
        "t_eval": np.linspace(0, 1, 23),
    }  # fmt: skip
    f, y0 = function("decays"), np.ones((10, 1))
    whole = cg.solve_ivp(f, (0, 1), y0, **options)
    wanted = np.exp(np.outer(whole.t, rates))
    np.testing.assert_allclose(whole.y[..., 0], wanted, rtol=1e-7)
    monkeypatch.setattr(member_output, "_MEMBERS", members)
    monkeypatch.setattr(member_output, "_STEPS", steps)
    monkeypatch.setattr(member_output, "_WITH_OUTPUT", enough)
    if steps < 100:
        monkeypatch.setattr(member_output.StepBudget, "start", lambda self: steps)
    pieces = cg.solve_ivp(f, (0, 1), y0, **options)
    np.testing.assert_array_equal(pieces.y, whole.y)
    np.testing.assert_array_equal(pieces.sol(whole.t), whole.sol(whole.t))
    assert [getattr(pieces, c) for c in COUNTS] == [getattr(whole, c) for c in COUNTS]


def test_work_comes_in_pieces_of_the_right_size(function, monkeypatch):
    """Neither does memory grow with the members, nor is every step a call from Python."""
    made, calls = [], []
    true, advance = member_output.interpolant_of, member_output.CompiledRun.advance

    def spied(frame, method, steps, evaluate):
        made.append(len(steps))
        return true(frame, method, steps, evaluate)

    def counted(self, *arguments, **options):
        calls.append(arguments)
        return advance(self, *arguments, **options)

    monkeypatch.setattr(member_output, "_WITH_OUTPUT", 50)
    monkeypatch.setattr(member_output, "interpolant_of", spied)
    monkeypatch.setattr(member_output.CompiledRun, "advance", counted)
    run = cg.solve_ivp(
        function("growth"), (0, 1), np.ones((300, 1)), frame=Euclidean(1), max_step=1 / 64,
        t_eval=np.linspace(0, 1, 10),
    )  # fmt: skip
    assert sum(made) == 300 * 8  # of the times both ends are ends of steps
    assert 50 <= max(made) < 60
    assert run.steps == 300 * 64
    assert 300 <= len(calls) < 1000


@pytest.mark.parametrize(
    ("name", "good", "bad", "options", "message"),
    [
        ("square", 0.0, 4.0, {}, "the step size fell below"),
        ("stops", 0.0, 1.0, {}, "f returned the error code 7 at t = 0"),
        ("square", 0.0, 1e160, {}, "f must return finite numbers"),
        ("growth", 1.0, 0.0, {"max_steps": 3}, "max_steps = 3 steps"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("dense", [False, True])
def test_members_whose_steps_fail(
    name, good, bad, options, message, dense, function, by_itself, monkeypatch
):
    monkeypatch.setattr(progress, "_SECONDS", 0.0)
    f, y0 = function(name), np.array([[good], [bad], [good]])
    options = {"frame": Euclidean(1), "t_eval": [0.0, 0.1, 0.5], "dense_output": dense, **options}
    told = []
    found = cg.solve_ivp(
        f, (0, 0.5), y0, progress=lambda done, total: told.append((done, total)), **options
    )
    assert told[-1] == (1.5, 1.5)
    assert told == sorted(told)
    assert by_itself == [(1,)]
    assert list(found.failures) == [(1,)]
    assert found.failures[1,].startswith(message)
    assert found.status == -1
    assert found.message.startswith("Failure of 1 of 3 trajectories; of y0[1]: ")
    for i in (0, 2):
        run = cg.solve_ivp(f, (0, 0.5), y0[i], **options)
        np.testing.assert_array_equal(found.y[:, i], run.y)
    assert np.isfinite(found.y[0]).all()
    assert np.isnan(found.y[-1, 1]).all()
    if dense:
        assert np.isfinite(found.sol(0.3)[[0, 2]]).all()


OPTIONS = {"frame": Euclidean(1), "method": "CG4(3)", "t_eval": [0.31, 0.72]}


class TestFunctionsThatFailBetweenSteps:
    """What is evaluated for output alone isn't evaluated by any step."""

    SIGNATURE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, DOUBLES, DOUBLES, ctypes.c_void_p)

    def f(self, times, bad=()):
        """Return y' = y; it fails there where the point is over 3."""

        def called(t, y, f, data):
            times.add(t)
            f[0] = y[0]
            return 9 if t in bad and y[0] > 3.0 else 0

        return self.SIGNATURE(called)

    def nodes(self, y0):
        """Return the times at which only the output needs the function."""
        steps, both = set(), set()
        cg.solve_ivp(self.f(steps), (0, 1), y0, frame=Euclidean(1), method="CG4(3)")
        cg.solve_ivp(self.f(both), (0, 1), y0, **OPTIONS)
        return both - steps

    @pytest.mark.parametrize("which", [min, max])
    @pytest.mark.parametrize("members", [1, 1000])
    def test_they_end_alone(self, which, members, monkeypatch, by_itself):
        monkeypatch.setattr(progress, "_SECONDS", 0.0)
        monkeypatch.setattr(member_output, "_MEMBERS", members)
        y0 = np.array([[1.0], [3.5], [1.5], [4.0]])
        bad = {which(self.nodes(y0[1])), which(self.nodes(y0[3]))}
        told = []
        found = cg.solve_ivp(
            self.f(set(), bad), (0, 1), y0, progress=lambda *two: told.append(two), **OPTIONS
        )
        assert told[-1] == (4.0, 4.0)
        assert told == sorted(told)
        assert by_itself == [(1,), (3,)]
        assert list(found.failures) == [(1,), (3,)]
        assert found.failures[1,].startswith("f returned the error code 9 at t = 0.")
        good = [0, 2]
        wanted = np.exp(found.t)[:, None] * y0[good, 0]
        np.testing.assert_allclose(found.y[:, good, 0], wanted, rtol=1e-3)
        assert np.isnan(found.y[-1, [1, 3]]).all()
        apart = [cg.solve_ivp(self.f(set()), (0, 1), y0[i], **OPTIONS) for i in good]
        assert found.steps >= sum(run.steps for run in apart)


@pytest.mark.parametrize("dense", [False, True])
def test_a_step_too_long_for_the_solution_within(dense, affine, monkeypatch, by_itself):
    """Which member it is comes out where each goes by itself."""

    def refuse(*arguments):
        raise StepTooLongError(0.0)

    problem = PROBLEMS["product"]
    f, _keep = affine(problem)
    y0 = problem.frame.random_point(np.random.default_rng(7), (3,))
    options = {"frame": problem.frame, "t_eval": [0.3], "dense_output": dense}
    monkeypatch.setattr(member_output, "interpolant_of", refuse)
    check(cg.solve_ivp(f, (0, 1), y0, **options), alone(f, (0, 1), y0, **options))
    assert by_itself == [(0,), (1,), (2,)]


def test_points_too_large_for_the_solution_within(function):
    """Between finite points it may not be, which ends nothing."""
    options = {"frame": Euclidean(1), "t_eval": [0.5], "rtol": 1e-3}
    y0 = np.array([[1.0], [1e308]])
    found = cg.solve_ivp(function("growth"), (0, 0.58), y0, **options)
    apart = [cg.solve_ivp(function("growth"), (0, 0.58), start, **options) for start in y0]
    for i, run in enumerate(apart):
        np.testing.assert_array_equal(found.y[:, i], run.y)
    assert math.isclose(found.y[0, 0, 0], math.exp(0.5), rel_tol=1e-4)
