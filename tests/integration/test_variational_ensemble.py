"""Derivatives of ensembles equal those of each member alone."""

import numpy as np
import pytest

import cg
from cg.frames import Euclidean

MEMBERS = 4
RNG = np.random.default_rng(7)


def swing(t, y, p):
    return [y[1] * p[0], -np.sin(y[0])]


def swing_jac(t, y, p):
    return [[0.0, p[0]], [-np.cos(y[0]), 0.0]]


def swing_dp(t, y, p):
    return [[y[1]], [0.0]]


def low(t, y, p):
    return y[0] + 0.1 * p[0]


def bounce(t, y, p):
    return [y[0], -0.9 * y[1]]


Y0 = RNG.standard_normal((MEMBERS, 2))
P = RNG.uniform(0.5, 1.5, (MEMBERS, 1))
GIVEN = {"frame": Euclidean(2), "jac": swing_jac, "df_dp": swing_dp, "rtol": 1e-9, "atol": 1e-9}
FLOOR = cg.Event(low, direction=-1, jump=bounce)


def members(**options):
    return cg.solve_variational_ensemble(swing, (0, 4), Y0, parameters=P, **(GIVEN | options))


def test_members_are_those_of_single_calls():
    p0 = np.stack([(k + 1) * np.eye(2) for k in range(MEMBERS)])
    options = {"events": FLOOR, "t_eval": [1.0, 4.0], "dense_output": True}
    solution = members(P0=p0, **options)
    assert solution.transition.shape == (2, MEMBERS, 2, 2)
    assert solution.sensitivity.shape == (2, MEMBERS, 2, 1)
    assert solution.covariance.shape == (2, MEMBERS, 2, 2)
    for k in range(MEMBERS):
        alone = cg.solve_variational(
            swing, (0, 4), Y0[k], parameters=P[k], P0=p0[k], **options, **GIVEN
        )
        member = solution[k]
        assert isinstance(member, cg.Solution)
        for name in ("t", "y", "transition", "sensitivity", "covariance"):
            np.testing.assert_array_equal(getattr(member, name), getattr(alone, name))
        for name in ("t_events", "y_events", "y_after", "dt_events"):
            np.testing.assert_array_equal(getattr(member, name)[0], getattr(alone, name)[0])
        np.testing.assert_array_equal(solution.dt_events[0][k], alone.dt_events[0])
        np.testing.assert_array_equal(member.sol(0.7), alone.sol(0.7))
        np.testing.assert_array_equal(member.sol.covariance(0.7), alone.sol.covariance(0.7))
    assert sum(each.size for each in solution.t_events[0]) >= 2
    assert solution.sol.transition([0.5, 0.7]).shape == (2, MEMBERS, 2, 2)
    np.testing.assert_array_equal(solution.sol.covariance(0.7)[2], solution[2].sol.covariance(0.7))
    assert repr(solution).startswith("EnsembleSolution(")


@pytest.mark.filterwarnings("ignore:Failure of")
def test_members_that_fail_are_nan():
    f = lambda t, y, p: [p[0] * y[0] ** 2]
    solution = cg.solve_variational_ensemble(
        f, (0, 2), [1.0], frame=Euclidean(1), parameters=[[0.25], [1.0]], t_eval=[0.5, 2.0]
    )
    assert solution.status.tolist() == [0, -1]
    assert np.isfinite(solution.transition[:, 0]).all()
    assert np.isnan(solution.transition[1, 1])
    assert solution[1].transition.shape == (1, 1, 1)
    np.testing.assert_allclose(solution.transition[0, 0], 1 / (1 - 0.125) ** 2, rtol=1e-3)


@pytest.mark.parametrize("span", [(0, 2), (2, 0)])
@pytest.mark.parametrize("common", [False, True])
def test_forces_on_spheres(span, common):
    """Of many points at a time, with a part along the normal that has no effect.

    Coordinates on spheres aren't unique, so that tangent vectors are compared.
    """
    frame = cg.frames.PhaseSpace(cg.frames.Sphere(2))
    y0 = frame.join([0.6, 0.0, 0.8], [0.3, 1.0, 0.1])
    weight, h = 1.7, 1e-4
    force = lambda t, y, p: (
        p[..., :1] * [0, 0, -1.0] + np.cross(y[..., :3], [0, 0, 0.3]) + 2.0 * y[..., :3]
    )
    run = cg.solve_variational_ensemble(
        force, span, [y0] * 2, parameters=[[1.0], [weight]], frame=frame, vectorized=True,
        common_steps=common, rtol=1e-9, atol=1e-9, control_derivatives=True,
    )  # fmt: skip
    moved = lambda y, p: cg.solve_ivp(
        force, span, y, parameters=[p], frame=frame, rtol=1e-12, atol=1e-12
    ).y[-1]
    slope = lambda end: (8 * (end(h) - end(-h)) - (end(2 * h) - end(-2 * h))) / (12 * h)
    for w in np.eye(6):
        expected = slope(lambda s, w=w: moved(frame.flow(s * w, y0), weight))
        tangent = frame.field(run.transition[-1, 1] @ w, run.y[-1, 1])
        np.testing.assert_allclose(tangent, expected, rtol=0, atol=2e-8)
    expected = slope(lambda s: moved(y0, weight + s))
    tangent = frame.field(run.sensitivity[-1, 1, :, 0], run.y[-1, 1])
    np.testing.assert_allclose(tangent, expected, rtol=0, atol=2e-8)
