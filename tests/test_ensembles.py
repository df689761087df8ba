"""Ensembles of initial points: every member is what it is alone."""

import re
import tracemalloc
from functools import partial

import numpy as np
import pytest
from compiled_examples import PROBLEMS

import cg
from cg.frames import SE3, SO, SO3, SU, CoadjointOrbit, Euclidean, Product, Sphere, Stiefel
from cg.integration.arguments import check_points
from cg.problems import StateDependentRotation

PROBLEM = StateDependentRotation()


class Uncompiled(Euclidean):
    """A frame whose steps are taken in Python."""

    def compiled_blocks(self):
        return None


@pytest.mark.parametrize(
    "frame", [SO3(), SO3("space"), Sphere(2), Product(SO3(), Euclidean(2)), CoadjointOrbit]
)
def test_ensembles_equal_loops(frame):
    rng = np.random.default_rng(5)
    if frame is CoadjointOrbit:
        frame = CoadjointOrbit(SO3(), (0.6, 0.0, 0.8))
    y0 = frame.random_point(rng, (2, 3))
    weights = rng.standard_normal((frame.dim, int(np.prod(frame.point_shape))))

    def f(t, y):
        lead = y.shape[: y.ndim - len(frame.point_shape)]
        return np.cos(y.reshape(*lead, -1) @ weights.T + t)

    times = [0.0, 0.15, 0.4, 1.0]
    options = {"frame": frame, "method": "CG4a", "h": 0.2, "t_eval": times, "dense_output": True}
    together = cg.solve_ivp(f, (0.0, 1.0), y0, **options)
    assert together.y.shape == (4, 2, 3, *frame.point_shape)
    assert together.sol([[0.1, 0.2]]).shape == (1, 2, 2, 3, *frame.point_shape)
    for index in np.ndindex(2, 3):
        alone = cg.solve_ivp(f, (0.0, 1.0), y0[index], **options)
        np.testing.assert_allclose(together.y[:, *index], alone.y, rtol=0, atol=1e-14)
        np.testing.assert_allclose(together.sol(0.33)[index], alone.sol(0.33), rtol=0, atol=1e-14)
        assert (together.nfev, together.nexp) == (alone.nfev, alone.nexp)


@pytest.mark.parametrize(
    "frame",
    [SO3(), SE3("space"), SU(2), Sphere(2), Product(SO3(), Euclidean(2)), SO(4), Stiefel(3, 1)],
    ids=repr,
)
def test_adaptive_ensembles_agree_with_separate_runs(frame):
    rng = np.random.default_rng(5)
    y0 = frame.random_point(rng, (2, 3))
    weights = rng.standard_normal((frame.dim, 2 * int(np.prod(frame.point_shape))))
    lead = slice(None, -len(frame.point_shape))

    def f(t, y):
        flat = y.reshape(*y.shape[lead], -1)
        return np.cos(np.concatenate([flat.real, flat.imag], axis=-1) @ weights.T + t)

    times = [0.0, 0.15, 0.4, 1.0]
    options = {"frame": frame, "rtol": 1e-6, "atol": 1e-6, "dense_output": True}
    together = cg.solve_ivp(f, (0.0, 1.0), y0, t_eval=times, **options)
    free = cg.solve_ivp(f, (0.0, 1.0), y0, **options)
    assert together.y.shape == (4, *y0.shape)
    assert free.y.shape == (free.steps + 1, *y0.shape)
    np.testing.assert_allclose(free.sol(times), together.y, rtol=0, atol=1e-13)
    assert free.sol([[0.1, 0.2]]).shape == (1, 2, *y0.shape)
    steps = []
    for index in np.ndindex(2, 3):
        alone = cg.solve_ivp(f, (0.0, 1.0), y0[index], t_eval=times, **options)
        assert frame.distance(together.y[:, *index], alone.y).max() < 2e-5
        assert frame.distance(free.sol(0.33)[index], alone.sol(0.33)) < 2e-5
        steps.append(alone.steps)
    assert max(steps) <= together.steps == free.steps <= 1.3 * max(steps)
    assert frame.membership_error(free.y).max() < 1e-13


def test_an_ensemble_of_one_takes_the_steps_of_its_member():
    options = {"frame": SO3(), "rtol": 1e-6}
    alone = cg.solve_ivp(PROBLEM.f, (0, 1), np.eye(3), **options)
    together = cg.solve_ivp(
        lambda t, y: PROBLEM.f(t, y[0])[None], (0, 1), np.eye(3)[None], **options
    )
    np.testing.assert_array_equal(together.t, alone.t)
    np.testing.assert_array_equal(together.y[:, 0], alone.y)
    assert (together.nfev, together.nexp) == (alone.nfev, alone.nexp)


def test_a_member_that_blows_up_ends_an_ensemble_with_common_steps():
    y0 = [[0.5], [2.0]]
    solution = cg.solve_ivp(lambda t, y: y**2, (0, 1), y0, frame=Euclidean(1))
    assert solution.status == -1
    assert solution.t[-1] == pytest.approx(0.5, abs=1e-2)
    np.testing.assert_allclose(solution.y[-1, 0], 1 / (2 - solution.t[-1]), rtol=1e-2)


def decay(function, rates, ends):
    """Return a compiled right-hand side and the numbers of its members."""
    return function("decays"), np.stack([rates, ends], axis=-1)


RATES, NEVER = np.array([[-1.0, -2.0, 0.5], [0.0, -0.5, 1.5]]), np.full((2, 3), 1e9)
LATER = {"frame": Euclidean(1), "rtol": 1e-9, "atol": 1e-9}
EQUAL = {"frame": Euclidean(1), "method": "CG6g", "h": 1 / 32}


@pytest.mark.parametrize("options", [LATER, EQUAL], ids=["adaptive", "fixed"])
def test_members_have_parameters_of_their_own(options, function):
    f, parameters = decay(function, RATES, NEVER)
    y0 = np.ones((2, 3, 1))
    found = cg.solve_ivp(f, (0, 1), y0, parameters=parameters, t_eval=[0.3, 1.0], **options)
    for t, y in zip(found.t, found.y, strict=True):
        np.testing.assert_allclose(y[..., 0], np.exp(RATES * t), rtol=1e-8)
    implicit = {"frame": Euclidean(1), "method": "DICG6", "h": 1 / 16}
    slow = cg.solve_ivp(f, (0, 1), y0, parameters=parameters, **implicit)
    np.testing.assert_allclose(slow.y[-1, ..., 0], np.exp(RATES), rtol=1e-7)
    one = cg.solve_ivp(f, (0, 1), [1.0], parameters=[-3.0, 1e9], **options)
    assert one.y[-1, 0] == pytest.approx(np.exp(-3.0), rel=1e-7)


def test_parameters_of_threads(function):
    rates = np.linspace(-1, 1, 50)
    f, parameters = decay(function, rates, np.full(50, 1e9))
    runs = [
        cg.integrate(
            f, (0, 1), np.ones((50, 1)), parameters=parameters, workers=workers, save_every=5,
            **EQUAL,
        )
        for workers in (1, 3)
    ]  # fmt: skip
    np.testing.assert_array_equal(runs[0].y, runs[1].y)
    np.testing.assert_allclose(runs[0].y[-1, :, 0], np.exp(rates), rtol=1e-8)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (np.ones((3, 2)), r"parameters must have shape \(2, 3, k\), got \(3, 2\)"),
        (np.ones((2, 3, 0)), r"parameters must have shape \(2, 3, k\), got \(2, 3, 0\)"),
        ("many", "parameters must be an array of real numbers"),
    ],
)
def test_bad_parameters_are_refused(parameters, message, function):
    with pytest.raises(ValueError, match=message):
        cg.solve_ivp(function("decays"), (0, 1), np.ones((2, 3, 1)), parameters=parameters, **LATER)


def test_parameters_are_for_compiled_functions_without_data(affine):
    problem = PROBLEMS["SO3 body"]
    f, _keep = affine(problem)
    options = {"frame": problem.frame, "parameters": [1.0]}
    with pytest.raises(ValueError, match="parameters must be None for a compiled f that has user"):
        cg.solve_ivp(f, (0, 1), problem.y0, **options)
    with pytest.raises(ValueError, match="parameters must be None unless f is compiled"):
        cg.solve_ivp(problem.f, (0, 1), problem.y0, **options)


@pytest.mark.parametrize("extra", [{}, {"t_eval": [0.25, 0.5, 1.0]}, {"dense_output": True}])
@pytest.mark.parametrize("options", [LATER, EQUAL], ids=["adaptive", "fixed"])
def test_a_member_that_fails_ends_alone(options, extra, function):
    ends = NEVER.copy()
    ends[1, 0] = 0.6
    f, parameters = decay(function, RATES, ends)
    found = cg.solve_ivp(f, (0, 1), np.ones((2, 3, 1)), parameters=parameters, **options, **extra)
    assert (found.status, found.success) == (-1, False)
    assert list(found.failures) == [(1, 0)]
    assert re.match(r"f returned the error code 5 at t = 0\.[6-9]", found.failures[1, 0])
    assert found.message.startswith("Failure of 1 of 6 trajectories; of y0[1, 0]: f returned")
    whole = np.delete(found.y.reshape(len(found.t), 6), 3, axis=1)
    exact = np.exp(found.t[:, None] * np.delete(RATES.ravel(), 3))
    np.testing.assert_allclose(whole, exact, rtol=1e-8)
    failed = found.y[:, 1, 0, 0]
    ended = float(found.failures[1, 0].split("= ")[1])
    assert np.isnan(failed[found.t > ended]).all()
    assert (failed[found.t < 0.3] == 1.0).all()  # its rate is zero
    if found.sol is not None:
        assert np.isnan(found.sol(0.9)[1, 0, 0])
        np.testing.assert_allclose(found.sol(0.9)[0, :, 0], np.exp(0.9 * RATES[0]), rtol=1e-8)


def test_a_member_that_fails_ends_alone_in_integrate_too(function):
    ends = NEVER.copy()
    ends[1, 0] = 0.6
    f, parameters = decay(function, RATES, ends)
    with pytest.warns(UserWarning, match=r"1 members of the ensemble failed, y0\[1, 0\] since f"):
        found = cg.integrate(f, (0, 1), np.ones((2, 3, 1)), parameters=parameters, **EQUAL)
    assert list(found.failures) == [(1, 0)]
    np.testing.assert_allclose(found.y[-1, 0, :, 0], np.exp(RATES[0]), rtol=1e-8)
    assert np.isnan(found.y[-1, 1, 0, 0])


@pytest.mark.parametrize("in_c", [True, False], ids=["C", "Python"])
@pytest.mark.parametrize("options", [LATER, EQUAL], ids=["adaptive", "fixed"])
@pytest.mark.parametrize("terminal", [True, False])
def test_events_of_members(in_c, options, terminal, function):
    rates, level = np.array([-1.0, -2.0, -0.1]), 0.4
    f, extra = (lambda t, y: rates[:, None] * y), {}
    if in_c:
        f, extra["parameters"] = decay(function, rates, np.full(3, 1e9))

    def reaches(t, y):
        assert y.shape == (1,)
        return y[0] - level

    reaches.terminal = terminal
    found = cg.solve_ivp(
        f, (0, 1), np.ones((3, 1)), events=reaches, dense_output=True, **extra, **options
    )
    wanted = np.log(level) / rates  # the last one is beyond the end
    (times,), (points,) = found.t_events, found.y_events
    assert [len(t) for t in times] == [1, 1, 0]
    for i in range(2):
        assert times[i][0] == pytest.approx(wanted[i], abs=2e-9)
        assert points[i][0] == pytest.approx(level, abs=1e-12)
        after = found.sol(min(1.0, wanted[i] + 0.01))[i]
        assert np.isnan(after).all() == terminal
    assert found.sol(0.99)[2, 0] == pytest.approx(np.exp(-0.099), rel=1e-8)
    assert np.isnan(found.y[-1, :2]).all() == terminal
    assert found.status == 0


BLOWS_UP = {
    "pair": {"method": "CF5(4)"},
    "algebra": {"method": "RKMK5(4)"},
    "fixed": {"method": "CG3", "h": 0.01},
    "implicit": {"method": "DICG3(2)"},
}


@pytest.mark.parametrize("frame", [Euclidean(1), Uncompiled(1)], ids=["compiled", "in Python"])
@pytest.mark.parametrize("options", BLOWS_UP.values(), ids=BLOWS_UP)
@pytest.mark.parametrize("outputs", [{}, {"t_eval": [0.0, 0.5, 2.0]}, {"dense_output": True}])
def test_a_member_that_an_event_has_ended_does_not_stop_the_others(frame, options, outputs):
    """It would be infinite at t = 1."""

    def reaches(t, y):
        return y[0] - 10.0

    reaches.terminal = True
    found = cg.solve_ivp(
        lambda t, y: y**2, (0, 2), [[1.0], [0.1]], frame=frame, events=reaches, **options, **outputs
    )
    assert (found.status, found.failures) == (0, {})
    assert [len(times) for times in found.t_events[0]] == [1, 0]
    assert found.t_events[0][0][0] == pytest.approx(0.9, abs=2e-3)
    assert found.t[-1] == 2.0
    assert np.isnan(found.y[-1, 0]).all()
    assert found.y[-1, 1, 0] == pytest.approx(0.125, rel=1e-4)
    if found.sol is not None:
        assert found.sol(0.85)[0, 0] == pytest.approx(1 / 0.15, rel=2e-2)
        assert np.isnan(found.sol(1.5)[0]).all()


@pytest.mark.parametrize("frame", [Euclidean(1), Uncompiled(1)], ids=["compiled", "in Python"])
@pytest.mark.parametrize("options", [{"h": 0.25, "method": "CG3"}, {"max_step": 0.25}])
def test_what_f_returns_for_a_member_that_has_ended_does_not_matter(frame, options):
    """It is NaN for the first member from the step on that follows its event."""

    def f(t, y):
        return [[-1.0 if t < 0.76 else np.nan], [1.0]]

    def halved(t, y):
        return y[0] - 0.5

    halved.terminal = True
    found = cg.solve_ivp(f, (0, 3), [[1.0], [1.0]], frame=frame, events=halved, **options)
    assert (found.status, found.t[-1]) == (0, 3.0)
    assert found.t_events[0][0][0] == pytest.approx(0.5, abs=1e-12)
    assert np.isnan(found.y[-1, 0]).all()
    assert found.y[-1, 1, 0] == pytest.approx(4.0, rel=1e-12)


def test_terminal_events_of_all_members_end_it_all(function):
    rates = np.array([-1.0, -2.0])
    event = lambda t, y: y[0] - 0.5  # noqa: E731
    event.terminal = True
    f, parameters = decay(function, rates, np.full(2, 1e9))
    for rhs, extra in ((f, {"parameters": parameters}), (lambda t, y: rates[:, None] * y, {})):
        for options in (LATER, EQUAL):
            found = cg.solve_ivp(rhs, (0, 5), np.ones((2, 1)), events=event, **extra, **options)
            assert (found.status, found.message) == (1, "A terminal event ended the integration.")
            assert found.t_events[0][1][0] == pytest.approx(np.log(2) / 2, abs=1e-8)


def test_a_compiled_function_that_writes_into_its_point(function):
    """It is given a copy: whatever leads to it, the answer is the same."""
    f = function("overwrites")
    ways = (
        {"method": "CG5a", "h": 0.01},
        {"rtol": 1e-10, "atol": 1e-10, "t_eval": [1.0]},
        {"method": "DICG6", "h": 0.01},
        {"method": "CF6a", "h": 0.01},  # whose flows go on from stages
        {"method": "CF5r", "h": 0.01},  # in two registers
    )
    for options in ways:
        for y0 in ([1.0], [[1.0], [1.0]]):
            found = cg.solve_ivp(f, (0, 1), y0, frame=Euclidean(1), **options)
            np.testing.assert_allclose(found.y[-1], np.full_like(y0, np.exp(-1.0)), rtol=1e-9)


@pytest.mark.parametrize("shape", [(2,), (1,)])
def test_where_all_members_fail_what_they_reached_is_kept_and_nothing_else(shape, function):
    f, parameters = decay(function, np.full(shape, -1.0), np.full(shape, 0.6))
    y0 = np.ones((*shape, 1))
    with pytest.warns(UserWarning, match="members of the ensemble failed"):
        run = cg.integrate(f, (0, 1), y0, parameters=parameters, **EQUAL)
    found = cg.solve_ivp(f, (0, 1), y0, parameters=parameters, **EQUAL)
    assert len(run.failures) == len(found.failures) == len(y0)
    assert found.nrejected == 0
    for t, y in ((run.t, run.y), (found.t, found.y)):
        np.testing.assert_allclose(t, np.arange(len(t)) / 32, rtol=0, atol=1e-15)
        assert 0.5 < t[-1] < 0.65
        np.testing.assert_allclose(y[..., 0], np.exp(-t)[:, None] * np.ones(shape), rtol=1e-8)


def test_the_point_that_is_wrong_is_found_among_many():
    y0 = np.broadcast_to(np.eye(3), (100, 100, 3, 3)).copy()
    run = partial(cg.solve_ivp, PROBLEM.f, (0, 1), frame=SO3())
    y0[80, 7] *= 1.01
    with pytest.raises(ValueError, match=r"y0\[80, 7\] must be a point of SO3\(\)"):
        run(y0)
    y0[90, 3, 1, 1] = np.nan
    y0[99, 99] *= 2.0
    with pytest.raises(ValueError, match=r"y0\[90, 3\] must be finite"):
        run(y0)


def test_checking_points_takes_little_memory():
    y0 = np.broadcast_to(np.eye(3), (50_000, 3, 3))
    check_points(SO3(), y0[:10])
    tracemalloc.start()
    try:
        points = check_points(SO3(), y0)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert points.nbytes <= peak < 1.6 * points.nbytes
