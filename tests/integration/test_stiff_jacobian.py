"""Jacobians of RadauIIA5: given, by differences, sparse, with brackets."""

import numpy as np
import pytest
from refusals import refuses
from scipy import sparse
from van_der_pol import jacobian, solve, sparse_jacobian

import cg
from cg.frames import SO3, Euclidean, Sphere


@pytest.mark.parametrize("jac", [jacobian, sparse_jacobian])
def test_given(jac):
    run, other = solve(jac=jac), solve()
    np.testing.assert_allclose(run.y[-1], other.y[-1], rtol=5e-8)
    assert run.nfev < other.nfev


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize(("rtol", "atol"), [(1e-3, 1e-6), (1e-6, 1e-6), (1e-6, 1e-10)])
def test_differences_of_small_coordinates(unit, rtol, atol):
    """Of Robertson's reaction, in which 1e-13 of a substance remains."""

    def f(t, y):
        slow, fast, slowest = 0.04 * y[0], 1e4 / unit * y[1] * y[2], 3e7 / unit * y[1] ** 2
        return [fast - slow, slow - fast - slowest, slowest]

    def jac(t, y):
        fast, slowest = 1e4 / unit * y[1:][::-1], 6e7 / unit * y[1]
        return [[-0.04, *fast], [0.04, -fast[0] - slowest, -fast[1]], [0.0, slowest, 0.0]]

    options = {"frame": Euclidean(3), "rtol": rtol, "atol": atol * unit}
    run, other = (solve(f, 1e11, [unit, 0.0, 0.0], jac=j, **options) for j in (None, jac))
    assert (run.success, run.steps) == (True, pytest.approx(other.steps, rel=0.05))
    reference = np.array([2.08334015e-08, 8.33336077e-14, 0.9999999791666])
    assert (np.abs(run.y[-1] / unit - reference) < max(100 * atol * rtol, atol)).all()


def test_differences_where_a_coordinate_vanishes():
    def f(t, y):
        return [-1e3 * y[0], 1e3 * y[0] - 1e6 * (y[1] - np.cos(t)) * (1 + y[1] ** 2), y[1] - y[2]]

    options = {"frame": Euclidean(3), "method": "RadauIIA5", "rtol": 1e-6, "atol": 1e-9}
    run = cg.solve_variational(f, (0, 2), [1.0, 0.0, 0.0], **options)
    np.testing.assert_allclose(run.transition[-1, 2, 2], np.exp(-2.0), rtol=1e-7)


@pytest.mark.parametrize("kind", [np.array, sparse.csc_array])
@pytest.mark.parametrize("frame", [SO3(), SO3("space"), Sphere(2)], ids=repr)
@pytest.mark.parametrize(("rate", "spin"), [(1e4, 0.0), (1.0, 30.0)])
def test_brackets_are_added(frame, kind, rate, spin):
    """With exact Jacobians Newton's method takes as many iterations as with differences.

    In a fast rotation brackets are most of the Jacobian.
    """
    fast = rate * np.array([[1.0, 0.2, 0.0], [-0.3, 2.0, 0.1], [0.0, 0.4, 3.0]])
    y0 = np.eye(3) if frame.point_shape == (3, 3) else np.array([0.0, 0.6, 0.8])

    def f(t, y):
        first = y.reshape(-1, 3)[0]
        return fast @ np.cross(first, [np.cos(t), np.sin(t), 0.0]) + spin * np.ones(3)

    def jac(t, y):
        h = 1e-6
        ends = [[f(t, frame.flow(s * v, y)) for v in np.eye(3)] for s in (h, -h)]
        return kind((np.array(ends[0]) - np.array(ends[1])).T / (2.0 * h))

    run, other = solve(f, 0.5, y0, frame, jac=jac), solve(f, 0.5, y0, frame)
    np.testing.assert_allclose(run.y[-1], other.y[-1], rtol=0, atol=2e-11)
    assert run.nfev + 3 * run.njev == pytest.approx(other.nfev, rel=0.02)


@pytest.mark.parametrize(("jac", "error", "message"), [
    (3, TypeError, r"jac must be callable as jac\(t, y\), got 3"),
    (lambda t, y: [[1.0]], ValueError, r"jac must return .*\(2, 2\), got shape \(1, 1\)"),
    (lambda t, y: sparse.eye_array(3), ValueError, r"jac must return .*\(2, 2\)"),
    (lambda t, y: np.full((2, 2), np.nan), ValueError, "jac must return finite numbers"),
    (lambda t, y: jacobian(t, y) * (1.0 if t < 1 else np.nan), ValueError, "finite"),
    (lambda t, y: sparse_jacobian(t, y) * (1.0 if t < 1 else np.inf), ValueError, "finite"),
    (lambda t, y: (jacobian if t > 1 else sparse_jacobian)(t, y), ValueError, "a sparse m"),
    (lambda t, y: (sparse_jacobian if t > 1 else jacobian)(t, y), ValueError, "an array"),
    (lambda t, y: (1j if t > 1 else 1) * sparse_jacobian(t, y), ValueError, "real numbers"),
    (lambda t, y: jacobian(t, y) / (0 if t > 1 else 1.0) // 0, ValueError, "finite"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_bad_values(jac, error, message):
    refuses(error, message, solve, jac=jac)


@pytest.mark.parametrize("at", [0.0, 1.0])
def test_exceptions_pass_through(at):
    def jac(t, y):
        if t >= at:
            raise KeyError("mine")
        return jacobian(t, y)

    refuses(KeyError, "mine", solve, jac=jac)


def test_other_methods_reject_jac():
    refuses(ValueError, "jac must", solve, method="auto", jac=jacobian)
