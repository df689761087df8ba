"""Ensembles of initial points: every member is what it is alone."""

import numpy as np
import pytest

import cg
from cg.frames import SE3, SO, SO3, SU, CoadjointOrbit, Euclidean, Product, Sphere, Stiefel
from cg.problems import StateDependentRotation

PROBLEM = StateDependentRotation()


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
