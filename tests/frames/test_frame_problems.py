"""A small problem for each of the less usual frames, against an independent reference."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cg
from cg.frames import (
    GL,
    SE3,
    SO3,
    SU,
    CoadjointOrbit,
    Euclidean,
    IsospectralOrbit,
    Product,
    Stiefel,
)

TIGHT = {"rtol": 1e-8, "atol": 1e-8}
INERTIA = np.array([1.0, 2.0, 2.5])
MOMENTUM = np.array([0.3, 0.1, 0.9])
TODA = np.diag([1.0, -0.5, 0.3, 2.0]) + np.diag([0.5, 1.0, 0.7], 1) + np.diag([0.5, 1.0, 0.7], -1)


def reference(f, span, y0):
    """Solve y' = f(t, y) for arrays of any shape, off the manifold."""
    shape = np.shape(y0)
    solution = solve_ivp(
        lambda t, y: np.ravel(f(t, y.reshape(shape))),
        span,
        np.ravel(y0),
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
    )
    return solution.y[:, -1].reshape(shape)


def bracket(lax):
    return np.triu(lax, 1) - np.tril(lax, -1)


def test_a_heavy_top_on_the_dual_of_rigid_motions():
    centre = np.array([0.0, 0.0, 1.3])  # weight times the vector to the centre of mass
    y0 = np.array([0.2, -0.1, 1.5, np.sin(0.4), 0.0, np.cos(0.4)])  # momentum and the vertical
    frame = CoadjointOrbit(SE3(), y0)

    def derivative(t, y):
        omega = y[:3] / INERTIA
        turning = np.cross(y[:3], omega) + np.cross(y[3:], centre)
        return np.concatenate([turning, np.cross(y[3:], omega)])

    def f(t, y):  # the gradient of the energy
        return np.concatenate([y[:3] / INERTIA, centre])

    np.testing.assert_allclose(frame.field(f(0, y0), y0), derivative(0, y0), rtol=0, atol=1e-15)
    solution = cg.solve_ivp(f, (0, 4), y0, frame=frame, **TIGHT)
    np.testing.assert_allclose(solution.y[-1], reference(derivative, (0, 4), y0), rtol=0, atol=1e-6)
    momentum, vertical = solution.y[:, :3], solution.y[:, 3:]
    np.testing.assert_allclose(np.vecdot(vertical, vertical), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.vecdot(momentum, vertical), y0[:3] @ y0[3:], rtol=0, atol=1e-14)


def test_oja_flow_finds_the_largest_eigenvectors():
    rng = np.random.default_rng(0)
    frame = Stiefel(5, 2)
    matrix = np.diag([0.1, 0.5, 1.0, 3.0, 4.0])
    y0 = frame.random_point(rng)

    def f(t, y):
        projection = y @ y.T
        return frame.group.coefficients(matrix @ projection - projection @ matrix)

    def derivative(t, y):
        return matrix @ y - y @ (y.T @ matrix @ y)

    np.testing.assert_allclose(frame.field(f(0, y0), y0), derivative(0, y0), rtol=0, atol=1e-14)
    solution = cg.solve_ivp(f, (0, 12), y0, frame=frame, t_eval=[1.0, 12.0], rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(solution.y[0], reference(derivative, (0, 1), y0), rtol=0, atol=1e-6)
    last = solution.y[1] @ solution.y[1].T
    np.testing.assert_allclose(last, np.diag([0.0, 0.0, 0.0, 1.0, 1.0]), rtol=0, atol=1e-6)
    assert frame.membership_error(solution.y).max() < 1e-15


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e12])
def test_final_points_of_scaled_runs_are_points(scale):
    orbit = CoadjointOrbit(SO3(), scale * MOMENTUM)
    isospectral = IsospectralOrbit.through(scale * TODA)
    both = Product(orbit, SO3(), Euclidean(1))

    def turn(t, m):
        return m / (scale * INERTIA)

    def toda(t, y):
        return isospectral.group.coefficients(bracket(y / scale))

    for frame, f, y0 in (
        (orbit, turn, scale * MOMENTUM),
        (isospectral, toda, scale * TODA),
        (both, lambda t, y: np.ones(7), both.join(scale * MOMENTUM, np.eye(3), [0.0])),
    ):
        options = {"frame": frame, "method": "CG4a", "h": 0.25}
        end = cg.solve_ivp(f, (0, 3), y0, **options).y[-1]
        assert cg.solve_ivp(f, (3, 6), end, **options).success
        wrong = y0 * (1.0 + 1e-6)
        with pytest.raises(ValueError, match=r"y0 must be a point of .* distance from"):
            cg.solve_ivp(f, (0, 3), wrong, **options)
        with pytest.raises(ValueError, match=r"y0\[1\] must"):
            cg.solve_ensemble(f, (0, 3), np.stack([y0, wrong]), **options)


@pytest.mark.parametrize(
    ("frame", "matrix", "name"),
    [
        (IsospectralOrbit.through(TODA), bracket(TODA), "frame.group.coefficients"),
        (Stiefel(4, 2), bracket(TODA), "frame.group.coefficients"),
        (GL(4), TODA, "frame.coefficients"),
        (SO3(), np.zeros((3, 3)), "frame.coefficients"),
        (SU(2), np.zeros((2, 2)), "frame.coefficients"),
    ],
)
def test_matrix_instead_of_coefficients_error_message(frame, matrix, name):
    y0 = TODA if isinstance(frame, IsospectralOrbit) else np.eye(*frame.point_shape)
    with pytest.raises(ValueError, match=rf"got shape .*{name}\(matrix\) are those of a matrix"):
        cg.solve_ivp(lambda t, y: matrix, (0, 1), y0, frame=frame)
