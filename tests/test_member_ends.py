"""Ensembles of which only the ends are wanted go there in compiled code, each in its own steps."""

import math

import numpy as np
import pytest
from compiled_examples import PROBLEMS

import cg
from cg.frames import SU, Euclidean
from cg.integration import member_ends, own_steps
from cg.problems.affine import AffineField

COUNTS = ("steps", "nrejected", "nfev", "nexp")
SQUARE = {"frame": Euclidean(1), "t_eval": [1.0]}


def one_by_one(f, span, y0, **options):
    """Return each member's own solution."""
    lead = np.ndim(y0) - len(options["frame"].point_shape)
    batch = np.shape(y0)[:lead]
    return {i: cg.solve_ivp(f, span, y0[i], **options) for i in np.ndindex(batch)}


@pytest.fixture
def in_compiled_code(monkeypatch):
    """Refuse the way of each member through Python."""

    def refuse(*arguments):
        raise AssertionError

    monkeypatch.setattr(own_steps, "_one_by_one", refuse)


@pytest.mark.parametrize("method", ["DP5(4)", "RKMK8(5,3)", "CF6(5)", "DOP853"])
@pytest.mark.parametrize("name", ["product", "sphere", "SU2 body"])
@pytest.mark.parametrize("span", [(0.0, 1.5), (1.0, -1.0)])
@pytest.mark.usefixtures("in_compiled_code")
def test_steps_are_those_of_members_alone(name, method, span, affine):
    problem = PROBLEMS[name]
    f, _keep = affine(problem)
    y0 = problem.frame.random_point(np.random.default_rng(7), (2, 3))
    options = {"frame": problem.frame, "method": method, "rtol": 1e-6, "atol": 1e-6}
    alone = one_by_one(f, span, y0, **options)
    assert len({run.steps for run in alone.values()}) > 1
    for wanted in (None, [], [span[0]], [span[1]], list(span)):
        found = cg.solve_ivp(f, span, y0, t_eval=wanted, **options)
        times = list(span) if wanted is None else wanted
        np.testing.assert_array_equal(found.t, times)
        assert found.y.shape == (len(times), *y0.shape)
        assert not found.y.flags.writeable
        for t, y in zip(times, found.y, strict=True):
            for i, run in alone.items():
                np.testing.assert_array_equal(y[i], run.y[0 if t == span[0] else -1])
        for count in COUNTS:
            assert getattr(found, count) == sum(getattr(run, count) for run in alone.values())
        assert found.success
        assert (found.status, found.message) == (0, "The end of t_span was reached.")
        assert found.t_events is None


def test_complex_points_and_no_span(affine, in_compiled_code):
    f, _keep = affine(PROBLEMS["SU2 space"])  # whose points are the same numbers
    y0 = SU(2).random_point(np.random.default_rng(1), (3,))
    options = {"frame": SU(2), "rtol": 1e-7}
    found = cg.solve_ivp(f, (0, 1), y0, **options)
    assert found.y.dtype == complex
    for i, run in one_by_one(f, (0, 1), y0, **options).items():
        np.testing.assert_array_equal(found.y[-1][i], run.y[-1])
    still = cg.solve_ivp(f, (1, 1), y0, t_eval=[1.0], **options)
    np.testing.assert_array_equal(still.y[0], y0)
    assert (still.steps, still.nfev, still.success) == (0, 0, True)


@pytest.mark.parametrize("members", [1, 3, 1000])
@pytest.mark.parametrize("steps", [1, 7])
def test_pieces_and_pauses_change_nothing(members, steps, function, monkeypatch):
    rates = np.linspace(-3, 3, 10)
    options = {
        "frame": Euclidean(1), "rtol": 1e-9, "atol": 1e-9,
        "parameters": np.stack([rates, np.full(10, 1e9)], axis=-1),
    }  # fmt: skip
    f, y0 = function("decays"), np.ones((10, 1))
    whole = cg.solve_ivp(f, (0, 1), y0, **options)
    np.testing.assert_allclose(whole.y[-1, :, 0], np.exp(rates), rtol=1e-7)
    monkeypatch.setattr(member_ends, "_MEMBERS", members)
    monkeypatch.setattr(member_ends.StepBudget, "start", lambda self: steps)
    pieces = cg.solve_ivp(f, (0, 1), y0, **options)
    np.testing.assert_array_equal(pieces.y, whole.y)
    assert [getattr(pieces, c) for c in COUNTS] == [getattr(whole, c) for c in COUNTS]


@pytest.mark.parametrize("members", [1, 256])
@pytest.mark.parametrize(
    ("name", "good", "bad", "options", "message"),
    [
        ("square", 0.0, 4.0, {}, "the step size fell below"),
        ("stops", 0.0, 1.0, {}, "f returned the error code 7 at t = 0"),
        ("square", 0.0, 1e160, {}, "f must return finite numbers"),
        ("growth", 1.0, 0.0, {"max_steps": 3}, "max_steps = 3 steps"),
    ],
)  # fmt: skip
def test_failures_are_those_of_members_alone(
    name, good, bad, options, message, members, function, monkeypatch
):
    monkeypatch.setattr(member_ends, "_MEMBERS", members)
    f, y0 = function(name), np.array([[good], [bad], [good]])
    found = cg.solve_ivp(f, (0, 0.5), y0, frame=Euclidean(1), **options)
    apart = cg.solve_ivp(f, (0, 0.5), y0, frame=Euclidean(1), t_eval=[0, 0.25, 0.5], **options)
    assert found.failures == apart.failures
    assert list(found.failures) == [(1,)]
    assert found.failures[1,].startswith(message)
    assert (found.status, found.message) == (-1, apart.message)
    np.testing.assert_array_equal(found.y, apart.y[[0, 2]])
    assert np.isnan(found.y[1]).ravel().tolist() == [False, True, False]


def test_a_right_hand_side_too_large_for_any_step(affine):
    problem = AffineField(Euclidean(1), [0.0])
    problem.constant[:] = 1e308
    f, _keep = affine(problem)
    found = cg.solve_ivp(f, (0, 1), [[0.0], [1.0]], frame=problem.frame)
    assert found.failures[0,].startswith("f is too large to choose a step at t = 0, got [1.")


def test_progress_is_the_sum_over_members(function, monkeypatch):
    monkeypatch.setattr(member_ends, "_MEMBERS", 2)
    monkeypatch.setattr("cg.integration.progress._SECONDS", 0.0)
    monkeypatch.setattr(member_ends.StepBudget, "start", lambda self: 2)  # members, then steps
    told = []
    cg.solve_ivp(
        function("growth"), (0, 2), np.ones((5, 1)), frame=Euclidean(1), rtol=1e-8,
        progress=lambda *now: told.append(now),
    )  # fmt: skip
    done, total = zip(*told, strict=True)
    assert set(total) == {10.0}
    assert list(done) == sorted(done)
    assert done[-1] == 10.0
    assert len({x for x in done if 0 < x < 4}) > 3  # within the first two
    assert math.isclose(max(x for x in done if x <= 4), 4.0)


def test_events_and_times_between_take_the_other_way(function, monkeypatch):
    def refuse(*arguments):
        raise AssertionError

    monkeypatch.setattr(own_steps, "member_ends", refuse)
    options = {"frame": Euclidean(1), "rtol": 1e-6}
    f, y0 = function("growth"), [[1.0], [2.0]]
    between = cg.solve_ivp(f, (0, 1), y0, t_eval=[0.0, 0.5], **options)
    np.testing.assert_allclose(between.y[1, :, 0], math.exp(0.5) * np.array([1, 2]), rtol=1e-5)
    crossed = cg.solve_ivp(f, (0, 1), y0, events=lambda t, y: y[0] - 2.5, **options)
    assert [len(times) for times in crossed.t_events[0]] == [1, 1]
    dense = cg.solve_ivp(f, (0, 1), y0, dense_output=True, **options)
    np.testing.assert_allclose(dense.sol(1.0), dense.y[-1])
