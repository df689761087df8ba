"""Runs on the less usual frames: their end points, and what they return in place of numbers."""

import numpy as np
import pytest

import cg
from cg.frames import GL, SO3, SU, CoadjointOrbit, Euclidean, IsospectralOrbit, Product, Stiefel

INERTIA = np.array([1.0, 2.0, 2.5])
MOMENTUM = np.array([0.3, 0.1, 0.9])
TODA = np.diag([1.0, -0.5, 0.3, 2.0]) + np.diag([0.5, 1.0, 0.7], 1) + np.diag([0.5, 1.0, 0.7], -1)


def bracket(lax):
    return np.triu(lax, 1) - np.tril(lax, -1)


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e12])
def test_final_points_of_scaled_runs_are_points(scale):
    orbit = CoadjointOrbit(SO3(), scale * MOMENTUM)
    isospectral = IsospectralOrbit.through(scale * TODA)
    both = Product(orbit, SO3(), Euclidean(1))

    turn = lambda t, m: m / (scale * INERTIA)
    toda = lambda t, y: isospectral.group.vee(bracket(y / scale))
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


@pytest.mark.parametrize(("frame", "matrix", "name"), [
    (IsospectralOrbit.through(TODA), bracket(TODA), "frame.group.vee"),
    (Stiefel(4, 2), bracket(TODA), "frame.group.vee"),
    (GL(4), TODA, "frame.vee"),
    (SO3(), np.zeros((3, 3)), "frame.vee"),
    (SU(2), np.zeros((2, 2)), "frame.vee"),
])  # fmt: skip
def test_matrix_instead_of_coefficients_error_message(frame, matrix, name):
    y0 = TODA if isinstance(frame, IsospectralOrbit) else np.eye(*frame.point_shape)
    with pytest.raises(ValueError, match=rf"got shape .*{name}\(matrix\) are those of a matrix"):
        cg.solve_ivp(lambda t, y: matrix, (0, 1), y0, frame=frame)
