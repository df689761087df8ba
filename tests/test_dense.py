"""The continuous solution: its order, its ends, the manifold it stays on."""

import numpy as np
import pytest

import cg
from cg.convergence import observed_order
from cg.frames import (
    GL,
    SE3,
    SL,
    SO,
    SO3,
    SU,
    CoadjointOrbit,
    Euclidean,
    IsospectralOrbit,
    Product,
    Sphere,
    Stiefel,
    UnitQuaternion,
)
from cg.integration.dense import Segment
from cg.integration.step import Step

FRAMES = [
    Euclidean(3),
    SO3(),
    SO3("space"),
    UnitQuaternion(),
    SE3(),
    SO(4),
    SU(2),
    SL(2),
    GL(2),
    Sphere(2),
    Sphere(3),
    Stiefel(3, 1),
    IsospectralOrbit((1.0, 2.0, 4.0)),
    CoadjointOrbit(SO3(), (0.6, 0.0, 0.8)),
    Product(SO3(), Euclidean(2)),
    Product(UnitQuaternion(), Sphere(2)),
]
WITHOUT_LOGARITHM = [Stiefel(3, 1), IsospectralOrbit((1.0, 2.0, 4.0)), FRAMES[13]]
T0 = 0.3


def generic(frame, seed=11):
    rng = np.random.default_rng(seed)
    y0 = frame.random_point(rng)
    weights = rng.standard_normal((frame.dim, 2 * y0.size)) / np.sqrt(2 * y0.size)

    def f(t, y):
        flat = y.ravel()
        return np.sin(weights @ np.concatenate([flat.real, flat.imag]) + np.arange(frame.dim) + t)

    return f, y0


def segment_of(frame, h, method="CG5a", pieces=6):
    """Return a segment between accurate points, and accurate points between its ends."""
    f, y0 = generic(frame)
    fine = cg.integrate(f, (T0, T0 + h), y0, frame=frame, method=method, h=abs(h) / pieces)
    step = Step(f, frame, cg.methods[method])
    return Segment(step, T0, y0, float(fine.t[-1]), fine.y[-1]), fine


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
@pytest.mark.parametrize("sign", [1, -1])
def test_local_order_is_four_at_least(frame, sign):
    sizes = np.array([0.2, 0.1, 0.05])
    errors = []
    for h in sizes:
        segment, fine = segment_of(frame, sign * h)
        errors.append(frame.distance(segment(fine.t), fine.y).max())
    order = observed_order(sizes, errors, floor=1e-14).order
    assert order > 3.7
    if frame in WITHOUT_LOGARITHM:
        assert order > 5.5


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_the_ends_are_exact_and_all_is_on_the_manifold(frame):
    f, y0 = generic(frame)
    solution = cg.solve_ivp(f, (0, 2), y0, frame=frame, method="CG4a", h=0.3, dense_output=True)
    np.testing.assert_array_equal(solution.sol(solution.t), solution.y)
    points = solution.sol(np.linspace(0, 2, 41))
    assert points.shape == (41, *frame.point_shape)
    assert frame.membership_error(points).max() < 1e-13


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_it_is_continuous_at_the_ends_without_their_being_set(frame):
    segment, _ = segment_of(frame, 0.3, pieces=1)
    ends = segment._blend(np.array([0.0, 1.0]))
    np.testing.assert_allclose(ends[0], segment.y0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(ends[1], segment.y1, rtol=0, atol=1e-14)
    assert (segment._bends is None) == (frame in WITHOUT_LOGARITHM)


@pytest.mark.parametrize("frame", [f for f in FRAMES if f not in WITHOUT_LOGARITHM], ids=repr)
def test_derivatives_at_the_ends_are_the_field(frame):
    f, _ = generic(frame)
    segment, _ = segment_of(frame, 0.3)
    d = 1e-5
    for t, y, inside in (
        (segment.t0, segment.y0, d),
        (segment.t1, segment.y1, -d),
    ):
        near = segment(np.array([t + inside, t + 2 * inside]))
        slope = (4 * near[0] - near[1] - 3 * y) / (2 * inside)
        np.testing.assert_allclose(slope, frame.field(f(t, y), y), rtol=0, atol=1e-8)


def test_on_flat_space_it_is_the_cubic_of_hermite():
    from scipy.interpolate import CubicHermiteSpline

    f, _ = generic(Euclidean(3))
    segment, _ = segment_of(Euclidean(3), 0.5)
    ends = [(segment.t0, segment.y0), (segment.t1, segment.y1)]
    cubic = CubicHermiteSpline(*zip(*ends, strict=True), [f(t, y) for t, y in ends])
    t = np.linspace(segment.t0, segment.t1, 20)
    np.testing.assert_allclose(segment(t), cubic(t), rtol=0, atol=1e-14)


def test_many_turns_in_one_step_do_not_lose_their_count():
    solution = cg.solve_ivp(
        lambda t, y: [0.0, 0.0, 50.0],
        (0, 1),
        np.eye(3),
        frame=SO3(),
        method="CG3",
        h=1.0,
        dense_output=True,
    )
    t = np.linspace(0, 1, 40)
    exact = SO3().flow(np.multiply.outer(t, [0.0, 0.0, 50.0]), np.eye(3))
    np.testing.assert_allclose(solution.sol(t), exact, rtol=0, atol=1e-13)


@pytest.mark.parametrize("frame", [SO3(), Sphere(2), Stiefel(3, 1)], ids=repr)
def test_global_order_between_steps_is_that_of_the_steps_up_to_four(frame):
    f, y0 = generic(frame)
    t = np.linspace(0, 2, 15)
    truth = cg.solve_ivp(f, (0, 2), y0, frame=frame, method="CG5a", h=2 / 120, t_eval=t).y
    sizes = 2.0 / np.array([8, 16, 32])
    errors = [
        frame.distance(
            cg.solve_ivp(f, (0, 2), y0, frame=frame, method="CG4a", h=h, t_eval=t).y, truth
        ).max()
        for h in sizes
    ]
    assert observed_order(sizes, errors).order > 3.7


def test_one_more_evaluation_is_all_it_costs():
    f, y0 = generic(SO3())
    for options in ({"method": "CG4a", "h": 0.25}, {"method": "CG2(3)"}):
        plain = cg.solve_ivp(f, (0, 1), y0, frame=SO3(), **options)
        dense = cg.solve_ivp(f, (0, 1), y0, frame=SO3(), dense_output=True, **options)
        np.testing.assert_array_equal(plain.y, dense.y)
        assert dense.nfev == plain.nfev + 1


def test_backward():
    f, y0 = generic(SO3())
    solution = cg.solve_ivp(f, (1, -1), y0, frame=SO3(), rtol=1e-9, atol=1e-9, dense_output=True)
    assert (solution.sol.t_min, solution.sol.t_max) == (-1.0, 1.0)
    truth = cg.integrate(f, (1, -0.5), y0, frame=SO3(), method="CG5a", h=0.01).y[-1]
    assert SO3().distance(solution.sol(-0.5), truth) < 1e-7
    np.testing.assert_array_equal(solution.sol(solution.t), solution.y)


def test_times_may_have_any_shape_and_order():
    f, y0 = generic(SO3())
    sol = cg.solve_ivp(f, (0, 1), y0, frame=SO3(), dense_output=True).sol
    t = np.random.default_rng(0).random((4, 5))
    points = sol(t)
    assert points.shape == (4, 5, 3, 3)
    assert sol(0.5).shape == (3, 3)
    assert sol([]).shape == (0, 3, 3)
    for index in np.ndindex(4, 5):
        np.testing.assert_allclose(points[index], sol(t[index]), rtol=0, atol=1e-15)
    assert "DenseOutput" in repr(sol)


@pytest.mark.parametrize("t", [-0.1, 1.1, [0.5, np.nan]])
def test_times_beyond_the_ends_are_refused(t):
    f, y0 = generic(SO3())
    sol = cg.solve_ivp(f, (0, 1), y0, frame=SO3(), dense_output=True).sol
    with pytest.raises(ValueError, match="t must lie between 0 and 1, got"):
        sol(t)
