"""Derivatives of ensembles equal those of each member alone."""

import numpy as np
import pytest

import cg
from cg.frames import Euclidean


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
    np.testing.assert_allclose(solution.transition[0, 0], 1 / (1 - 0.125) ** 2, rtol=1e-6)


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
