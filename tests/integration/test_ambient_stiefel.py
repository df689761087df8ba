"""Orthonormal columns whose right-hand sides return derivatives."""

import copy

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import cg
from cg.frames import AmbientStiefel, Product, check
from cg.problems.convergence import observed_order

SIZES = [(5, 1), (4, 2), (3, 3), (9, 4)]
H = np.array([1 / 8, 1 / 16, 1 / 32])


class Family:
    """Derivatives S(t, y) y of columns with a random skew matrix S, which turn them too."""

    def __init__(self, n, k, seed):
        rng = np.random.default_rng((n, k, seed))
        self.frame = AmbientStiefel(n, k)
        self.skew, self.driven = (x - x.T for x in rng.standard_normal((2, n, n)) / np.sqrt(n))
        self.metric = rng.standard_normal((n, n)) / np.sqrt(n)
        self.y0 = self.frame.random_point(rng)

    def generator(self, t, y):
        """Return S."""
        product = self.metric @ y @ y.mT
        return self.skew + np.cos(t) * self.driven + product - product.mT

    def __call__(self, t, y):
        """Return the derivative."""
        return self.generator(t, y) @ y

    def exact(self, end):
        """Return the solution of the equation of the entries."""

        f = lambda t, y: self(t, y.reshape(self.y0.shape)).ravel()
        run = solve_ivp(f, (0, end), self.y0.ravel(), method="DOP853", rtol=1e-13, atol=1e-13)
        return run.y[:, -1].reshape(self.y0.shape)


@pytest.mark.parametrize(("n", "k"), SIZES)
def test_axioms_and_solutions(n, k):
    for seed in range(3):
        problem = Family(n, k, seed)
        check(problem.frame, rng=np.random.default_rng(seed))
        y = cg.solve_ivp(problem, (0, 2), problem.y0, frame=problem.frame, rtol=1e-10, atol=1e-10)
        assert problem.frame.membership_error(y.y).max() < 1e-15 * n
        np.testing.assert_allclose(y.y[-1], problem.exact(2.0), rtol=0, atol=3e-9)


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-9, 1.0, 5.0])
@pytest.mark.parametrize(("n", "k"), [*SIZES, (20, 5)])
def test_flows_are_linear_fractional(n, k, size):
    frame, rng = AmbientStiefel(n, k), np.random.default_rng((n, k))
    v, y = frame.random_vector(rng, 4), frame.random_point(rng, 4)
    v *= size / np.linalg.norm(v, axis=-1, keepdims=True)
    moved = frame.flow(v, y)
    for matrix, start, end in zip(v.reshape(4, n, k), y, moved, strict=True):
        generator = np.block([[np.zeros((n, n)), matrix], [matrix.T, np.zeros((k, k))]])
        pair = expm(generator) @ np.concatenate([start, np.eye(k)])
        expected = np.linalg.solve(pair[n:].T, pair[:n].T).T
        np.testing.assert_allclose(end, expected, rtol=0, atol=1e-14 * np.exp(2.0 * size))
    assert frame.membership_error(moved).max() < 2e-15


@pytest.mark.parametrize("key", ["CG3", "CF4", "CG4a", "CF5(4)", "DOP853"])
@pytest.mark.parametrize(("n", "k"), [(4, 2), (6, 3)])
def test_orders(n, k, key):
    method, problem = cg.methods[key], Family(n, k, 7)
    steps = H if method.order < 8 else 4 * H
    exact = problem.exact(1.0)
    ends = [
        cg.integrate(problem, (0, 1), problem.y0, frame=problem.frame, method=key, h=h).y[-1]
        for h in steps
    ]
    errors = [np.linalg.norm(end - exact) for end in ends]
    assert observed_order(steps, errors) > method.order - 0.3


def test_only_the_projection_onto_tangents_counts():
    rng = np.random.default_rng(5)
    frame, gradient = AmbientStiefel(7, 3), rng.standard_normal((7, 3))
    y = frame.random_point(rng)
    symmetric = y.T @ gradient + gradient.T @ y
    tangent = frame.field(frame.complete_rhs(gradient, y), y)
    np.testing.assert_allclose(tangent, gradient - 0.5 * y @ symmetric, rtol=0, atol=1e-14)
    run = cg.solve_ivp(lambda t, y: gradient, (0, 60), y, frame=frame, rtol=1e-10, atol=1e-10)
    left, _, right = np.linalg.svd(gradient, full_matrices=False)
    np.testing.assert_allclose(run.y[-1], left @ right, rtol=0, atol=1e-9)  # the polar factor


def test_what_it_refuses():
    frame = AmbientStiefel(4, 2)
    y0 = np.eye(4, 2)
    with pytest.raises(ValueError, match=r"f must return an array of shape \(4, 2\), got shape"):
        cg.solve_ivp(lambda t, y: np.zeros(8), (0, 1), y0, frame=frame)
    with pytest.raises(ValueError, match="bracket"):
        cg.solve_ivp(lambda t, y: y, (0, 1), y0, frame=frame, method="RKMK4")
    with pytest.raises(OverflowError, match="can't be computed in double precision"):
        frame.flow(np.full(8, 1e4), y0)
    point = np.concatenate([y0.ravel(), y0.ravel()])
    pair = cg.solve_ivp(lambda t, y: np.zeros(16), (0, 1), point, frame=Product(frame, frame))
    np.testing.assert_allclose(pair.y[-1], point, rtol=0, atol=1e-15)


@pytest.mark.parametrize("method", ["auto", "CF4(3)"])
def test_factors_get_derivatives_too(method):
    rng = np.random.default_rng(8)
    single, skew = cg.frames.AmbientStiefel(5, 2), rng.standard_normal((5, 5))
    skew -= skew.T
    y0 = single.random_point(rng)
    options = {"method": method, "rtol": 1e-9, "atol": 1e-9}
    alone = cg.solve_ivp(lambda t, y: skew @ y, (0, 1), y0, frame=single, **options).y[-1]

    each = lambda t, y: np.concatenate([(skew @ part.reshape(5, 2)).ravel() for part in y])
    for n in (1, 3):
        frame = cg.frames.Power(single, n)
        end = cg.solve_ivp(each, (0, 1), np.stack([y0] * n), frame=frame, **options).y[-1]
        np.testing.assert_allclose(end, np.stack([alone] * n), rtol=0, atol=1e-8)
    frame = cg.frames.Product(single, cg.frames.Power(single, 1))

    def joined(t, y):
        return np.concatenate([(skew @ part.reshape(5, 2)).ravel() for part in np.split(y, 2)])

    end = cg.solve_ivp(joined, (0, 1), np.tile(y0.ravel(), 2), frame=frame, **options).y[-1]
    np.testing.assert_allclose(end, np.tile(alone.ravel(), 2), rtol=0, atol=1e-8)
    for other in (cg.frames.Euclidean(1), cg.frames.GL(1)):
        with pytest.raises(ValueError, match="factors with an AmbientStiefel must all be"):
            cg.frames.Product(frame, other)


def test_powers_meet_events_breakpoints_ensembles_copies_and_backward_steps():
    rng = np.random.default_rng(3)
    single, skew = cg.frames.AmbientStiefel(4, 2), rng.standard_normal((4, 4))
    skew -= skew.T
    frame = cg.frames.Power(single, 2)
    y0 = np.stack([single.random_point(rng), single.random_point(rng)])
    options = {"frame": frame, "rtol": 1e-10, "atol": 1e-10}

    f = lambda t, y: (skew @ y).reshape(*np.shape(t), -1)
    exact = lambda t, start=y0: expm(skew * t) @ start
    back = cg.solve_ivp(f, (0, -1), y0, **options).y[-1]
    np.testing.assert_allclose(back, exact(-1.0), rtol=0, atol=1e-8)
    level = exact(0.6)[0, 0, 0]
    run = cg.solve_ivp(
        f, (0, 1), y0, breakpoints=[0.3], events=lambda t, y: y[0, 0, 0] - level, **options
    )
    assert np.abs(run.t_events[0] - 0.6).min() < 1e-8
    starts = np.stack([y0, y0[::-1]])
    for vectorized in (False, True):
        together = cg.solve_ensemble(
            f, (0, 1), starts, t_eval=[1.0], vectorized=vectorized, **options
        )
        np.testing.assert_allclose(together.y[0], exact(1.0, starts), rtol=0, atol=1e-8)
    stepper = cg.Stepper(f, 0, y0, 1.0, method="CF5(4)", **options)
    stepper.step()
    stepper = copy.copy(stepper)
    while stepper.status == "running":
        stepper.step()
    np.testing.assert_allclose(stepper.y, exact(1.0), rtol=0, atol=1e-8)
