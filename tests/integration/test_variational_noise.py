"""Covariances with process noise, against quadrature and closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refuses
from waves import TIGHT

import cg
from cg.frames import SO3, Euclidean, PhaseSpace

NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)


def density_of(frame, seed=0):
    """Return a spectral density that depends on time, point and parameters."""
    g = np.random.default_rng(seed).standard_normal((frame.dim, frame.dim)) / 2

    def noise(t, y, *p):
        factor = g * np.exp(0.3 * t + 0.5 * np.real(y.ravel()[0]) + (0.2 * p[0][0] if p else 0.0))
        return factor @ factor.T

    return noise


def quadrature(sol, density, start, end, p0):
    """Return the integral of the propagated density, and the propagated initial covariance."""
    times = start + (end - start) * (NODES + 1) / 2
    total = sol.transition(end) @ p0 @ sol.transition(end).T
    for t, y, phi, weight in zip(times, sol(times), sol.transition(times), WEIGHTS, strict=True):
        move = sol.transition(end) @ np.linalg.inv(phi)
        total += weight * (end - start) / 2 * move @ density(t, y) @ move.T
    return total


def test_noise_on_a_phase_space():
    frame = PhaseSpace(SO3(), inertia=[1.0, 1.6, 2.3])
    y0, density = frame.join(np.eye(3), [0.1, 0.2, 0.3]), density_of(frame)
    q = density(0.0, np.zeros(1))
    for noise, function in ((q, lambda t, y: q), (density, density)):
        run = cg.solve_variational(
            lambda t, y: [np.sin(t), 0.1 * y[0], 0.2], (0, 1), y0, frame=frame, noise=noise,
            control_derivatives=True, dense_output=True, **TIGHT,
        )  # fmt: skip
        expected = quadrature(run.sol, function, 0.0, 1.0, np.zeros((6, 6)))
        np.testing.assert_allclose(run.covariance[-1], expected, rtol=0, atol=8e-12)


def test_a_compiled_density(affine):
    """It gives the numbers of one in Python, and is checked at the start."""
    constant, slope = np.diag([1.0, 2.0]), np.array([[0.5, 0.1], [0.1, 0.5]])
    linear = np.zeros((4, 2))

    def solve(noise):
        return cg.solve_variational(
            lambda t, y: [y[1], -np.sin(y[0])], (0, 1), [1.0, 0.0], frame=Euclidean(2),
            noise=noise, **TIGHT,
        )  # fmt: skip

    compiled, _data = affine(SimpleNamespace(constant=constant.ravel(), slope=slope.ravel(),
                                             linear=linear))  # fmt: skip
    expected = solve(lambda t, y: constant + t * slope)
    np.testing.assert_array_equal(solve(compiled).covariance, expected.covariance)
    wrong, _kept = affine(SimpleNamespace(constant=-constant.ravel(), slope=slope.ravel(),
                                          linear=linear))  # fmt: skip
    refuses(ValueError, "noise must be positive semidefinite", solve, wrong)


@pytest.mark.parametrize(("noise", "message"), [
    (np.eye(2), r"noise must have shape \(3, 3\), got \(2, 2\)"),
    (-np.eye(3), "noise must be positive semidefinite, got one with the eigenvalue -1"),
    (np.triu(np.ones((3, 3))), "noise must be symmetric"),
    (lambda t, y: np.eye(2), r"noise must return an array of shape \(3, 3\), got shape \(2, 2"),
    (lambda t, y: (0.5 - t) * np.eye(3),
     r"noise must be positive semidefinite, .* at t = 0\.[5-9]"),
    (lambda t, y: np.tri(3), "noise must be symmetric, .* at t = 0"),
    (lambda t, y: np.full((3, 3), np.nan), "noise must return finite numbers"),
    ("x", "noise must be an array of real numbers, got 'x'"),
])  # fmt: skip
def test_bad_noise_is_refused(noise, message):
    with pytest.raises(ValueError, match=message):
        cg.solve_variational(
            lambda t, y: [1.0, 0.0, t], (0, 1), np.eye(3), frame=SO3(), noise=noise, rtol=1e-6
        )


@pytest.mark.parametrize("noise", [[[2.0]], lambda t, y: [[2.0]]])
@pytest.mark.parametrize("solve", [cg.solve_variational, cg.solve_variational_ensemble])
@pytest.mark.parametrize("t_eval", [None, [0.5]])
def test_noise_backward_in_time_is_refused(solve, noise, t_eval):
    y0 = [1.0] if solve is cg.solve_variational else [[1.0], [2.0]]
    refuse = pytest.raises(ValueError, match=r"noise must be None backward in time.*\(1\.0, 0\.0\)")
    with refuse:
        solve(lambda t, y: -y, (1, 0), y0, frame=cg.frames.Euclidean(1), noise=noise, t_eval=t_eval)
