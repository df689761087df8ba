"""Coordinates of frames: sizes, nearby points, compiled blocks."""

import warnings

import numpy as np
import pytest
from frame_examples import FRAMES, name
from refusals import refuses
from scipy.optimize import minimize

from cg import frames as fr

pytestmark = pytest.mark.no_core

every_frame = pytest.mark.parametrize("frame", FRAMES, ids=name)


def largest(points, frame):
    axes = tuple(range(-len(frame.point_shape), 0))
    return np.abs(points).max(axis=axes)


@every_frame
def test_local_coordinates_broadcast_and_check_shapes(frame):
    rng = np.random.default_rng(73)
    y0 = frame.random_point(rng)
    v = 1e-3 * frame.random_vector(rng, (3,))
    y1 = frame.flow(v, y0)
    together = frame.local_coordinates(y0, y1)
    back = frame.local_coordinates(y1, y0)
    assert together.shape == back.shape == (3, frame.dim)
    for k in range(3):
        alone = frame.local_coordinates(y0, y1[k])
        np.testing.assert_allclose(together[k], alone, rtol=0, atol=5e-15)
    refuses(ValueError, "y0 must", frame.local_coordinates, np.append(y0, 1.0), y0)
    refuses(ValueError, "y1 must", frame.local_coordinates, y0, np.append(y0, 1.0))


@every_frame
def test_means_of_points_are_where_differences_cancel(frame):
    rng = np.random.default_rng(74)
    center = frame.random_point(rng)
    y = frame.flow(0.05 * frame.random_vector(rng, (5,)), center)
    w = np.array([1.0, 2.0, 0.5, -0.3, 1.0])
    if not np.isfinite(frame.difference(y[:1], y)).all():  # the fields don't lead there
        refuses(ValueError, "points must be near", frame.mean, y)
        return
    for weights in (None, w):
        mean = frame.mean(y, weights)
        differences = frame.difference(mean, y)
        tangents = frame._logarithms(mean, y)
        left = frame.field(np.average(tangents, axis=0, weights=weights), mean)
        np.testing.assert_allclose(left, 0, rtol=0, atol=5e-14)
    np.testing.assert_allclose(frame.flow(differences, mean), y, rtol=0, atol=4e-14)
    np.testing.assert_allclose(frame.mean(y[:1]), y[0], rtol=0, atol=2e-14)
    refuses(ValueError, "points must", frame.mean, y[0])
    refuses(ValueError, "weights must", frame.mean, y, -w)


def test_means_of_known_points():
    angles = np.array([0.1, 0.2, 0.6])
    turns = fr.SO3().flow(angles[:, None] * [0.0, 0.0, 1.0], np.eye(3))
    expected = fr.SO3().flow([0.0, 0.0, 0.3], np.eye(3))
    np.testing.assert_allclose(fr.SO3().mean(turns), expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(fr.Euclidean(1).mean([[1e8], [3e8]], [3, 1]), [1.5e8], rtol=1e-15)
    refuses(ValueError, "points must be near", fr.Sphere(2).mean, [[0, 0, 1.0], [0, 0, -1.0]])
    mean = fr.Hyperbolic(2).mean([[0.0, 1.0], [2.0, 1.0]])  # on a half circle
    np.testing.assert_allclose(mean, [1.0, np.sqrt(2.0)], rtol=0, atol=1e-14)
    v = fr.SPD(2).difference(np.eye(2), np.diag([2.0, 1.0]))
    np.testing.assert_allclose(v, [0.5 * np.log(2.0), 0, 0, 0], rtol=0, atol=1e-15)


@pytest.mark.parametrize(("frame", "y"), [
    *((fr.SO3(side), [np.eye(3), np.diag([1.0, -1, -1])]) for side in ("body", "space")),
    (fr.SO3(), [np.eye(3), *(2 * np.diag(e) - np.eye(3) for e in np.eye(3))]),
    *((frame, [np.eye(2), -np.eye(2)]) for frame in (fr.SO(2), fr.SU(2), fr.U(2))),
    (fr.SO(4), [np.eye(4), np.diag([1.0, 1, -1, -1])]),
    (fr.SE3(), [np.eye(4), np.diag([1.0, -1, -1, 1])]),
    (fr.Power(fr.Grassmann(3, 1), 1), [[np.diag([1.0, 0, 0])], [np.diag([0, 1.0, 0])]]),
    (fr.UnitQuaternion(), [[0, 0, 0, 1.0], [0.6, 0, 0, 0.8], [0, 0.6, 0, -0.8]]),
], ids=repr)  # fmt: skip
def test_points_that_have_several_means_have_none(frame, y):
    refuses(ValueError, "points must be near each other to have", frame.mean, y)


def test_means_of_far_points_have_the_least_sum_of_squares():
    rotation, angles = fr.SO(2), np.deg2rad([[0.0], [171.0], [-170.0]])
    mean = rotation.mean(rotation.flow(angles, np.eye(2)), [0.34, 0.33, 0.33])
    expected = rotation.flow(np.deg2rad([0.33 * (-189 - 170)]), np.eye(2))
    np.testing.assert_allclose(mean, expected, rtol=0, atol=1e-14)


def test_means_of_mechanical_systems_are_points_of_them():
    rod = fr.Joint("distance", (None, [0.0, 0, 0]), (0, [0.0, 0, 0]), length=1.0)
    q = fr.Sphere(2).flow(np.outer([0.1, 0.2, 0.9, 1.1], [1.0, 0.0, 0.0]), [0.0, 0.0, 1.0])
    for frame in (fr.PhaseSpace(fr.Sphere(2)), fr.PhaseSpace(fr.Euclidean(3), joints=[rod])):
        y = frame.join(q, np.tile([0.0, 1.0, 1.0], (4, 1)))
        mean = frame.mean(y, [0.3, 0.3, 0.2, 0.2])
        assert abs(mean[:3] @ mean[3:]) < 1e-15
        assert frame.membership_error(mean) < 1e-15


@pytest.mark.parametrize("frame", [
    fr.Hyperbolic(2), fr.Hyperbolic(4), fr.SPD(2), fr.SPD(3), fr.Grassmann(4, 2), fr.Sphere(3),
    fr.UnitQuaternion(), fr.Product(fr.SPD(2), fr.Hyperbolic(2)), fr.Power(fr.Hyperbolic(2), 2),
], ids=name)  # fmt: skip
@pytest.mark.parametrize("weights", [None, (1.0, 2.0, 0.5, 3.0, 1.0)])
def test_means_of_riemannian_manifolds_are_karchers(frame, weights):
    rng = np.random.default_rng(77)
    y = frame.flow(rng.uniform(-0.5, 0.5, (5, frame.dim)), frame.random_point(rng))
    mean, w = frame.mean(y, weights), np.ones(5) if weights is None else np.array(weights)
    cost = lambda v: w @ frame.distance(frame.flow(v, mean), y) ** 2
    least = frame.flow(minimize(cost, np.full(frame.dim, 0.05)).x, mean)
    assert frame.distance(least, mean) < 1e-5


@pytest.mark.parametrize("frame", [
    fr.SPD(2), fr.SPD(3), fr.Power(fr.SPD(2), 2), fr.Grassmann(3, 1), fr.Stiefel(4, 2),
    fr.CoadjointOrbit(fr.SL(2), (0.3, 1.0, -0.5)),
    fr.MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]]]),
], ids=name)  # fmt: skip
def test_differences_of_points_that_are_not_close(frame):
    """Where a whole step of the iteration overshoots."""
    rng = np.random.default_rng(78)
    y0 = np.ones(2) if frame.point_shape == (2,) else frame.random_point(rng)
    y = frame.flow(rng.uniform(-1.0, 1.0, (20, frame.dim)), y0)
    v = frame.difference(y0, y)
    np.testing.assert_allclose(frame.flow(v, y0), y, rtol=0, atol=1e-13 * np.abs(y).max())
    near = frame.flow(rng.uniform(-0.3, 0.3, (5, frame.dim)), y0)
    assert np.isfinite(frame.mean(near)).all()


@pytest.mark.parametrize("size", [1.0, 1e160, 1e-170])
def test_large_derivatives_keep_their_warning(size):
    frame, dy = fr.UnitQuaternion(), np.array([0.0, 0.0, size, size])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        v = frame.coefficients([0, 0, 0, 1], dy)
    np.testing.assert_allclose(v, [0, 0, 2 * size], rtol=1e-15)
    assert ["dropped: 0.707" in str(one.message) for one in caught] == [True] * (size >= 1)


def test_coordinate_sizes():
    frame = fr.Product(fr.SO3(), fr.Euclidean(2), fr.Semidirect(fr.SO3(), 2), fr.SE3(), fr.SU(2))
    point = np.eye(5)
    point[:3, 3], point[:3, 4] = [3.0, 0.0, 4.0], [0.0, -7.0, 0.0]
    y = frame.join(np.eye(3), [-2.0, 0.5], point, point[:4, :4], np.eye(2))
    ones = np.ones(3)
    expected = np.concatenate(
        [ones, [2.0, 0.5], ones, 5.0 * ones, 7.0 * ones, ones, 5.0 * ones, ones]
    )
    np.testing.assert_array_equal(frame.coordinate_sizes(y), expected)
    many = frame.coordinate_sizes(np.stack([y, 2.0 * y]))
    assert many.shape == (2, frame.dim)
    np.testing.assert_array_equal(many[1, 3:5], [4.0, 1.0])
    # a dilation, whose size is one, and translations
    np.testing.assert_array_equal(fr.Hyperbolic(3).coordinate_sizes([6.0, 0.0, 8.0]), [1, 10, 10])


COMPILED = [fr.Euclidean, fr.SO3, fr.SO, fr.UnitQuaternion, fr.SE3, fr.Sphere, fr.SU]


@pytest.mark.parametrize("kind", COMPILED)
def test_subclasses_are_not_compiled(kind):
    """A subclass may have other flows."""
    arguments = {fr.Euclidean: (2,), fr.SO: (3,), fr.Sphere: (2,), fr.SU: (2,)}.get(kind, ())
    assert kind(*arguments).compiled_blocks() is not None
    child = type("Child", (kind,), {})(*arguments)
    assert child.compiled_blocks() is None
    assert fr.Product(fr.Euclidean(1), child).compiled_blocks() is None


@every_frame
def test_local_coordinates_keep_large_logarithms(frame):
    rng = np.random.default_rng(79)
    y0, y1 = frame.random_point(rng, (20,)), frame.random_point(rng, (20,))
    known = frame.exp_coordinates(y0, y1)
    if known is None:
        return
    coordinates = frame.local_coordinates(y0, y1)
    has = np.isfinite(known).all(axis=-1)
    assert np.isfinite(coordinates[has]).all()
    off, before = (
        largest(frame.flow(v[has], y0[has]) - y1[has], frame) for v in (coordinates, known)
    )
    assert (off <= np.maximum(before, 5e-15 * largest(y1[has], frame))).all()


@every_frame
def test_flows_and_coordinates_that_overflow_do_not_warn(frame):
    rng = np.random.default_rng(3)
    for size in 10.0 ** np.array([1.0, 1.3, 2.0, 2.5, 2.8, 3.0]):
        y0, v = frame.random_point(rng), size * rng.uniform(-1, 1, frame.dim)
        try:
            y1 = frame.flow(v, y0)
        except OverflowError:
            continue
        if np.isfinite(y1).all():
            frame.local_coordinates(y0, y1)
