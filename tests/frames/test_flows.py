"""Compiled flows, several at once, against exponentials of the fields, which are linear."""

import numpy as np
import pytest
from compiled_differences import compiled_flows, difference_of
from compiled_examples import FRAMES as STARTS
from compiled_examples import ORBITS
from exact_matrices import doubles, flint_matrix
from flint import ctx

from cg.frames import (
    SE3,
    SO,
    SO3,
    SU,
    Euclidean,
    HomogeneousSpace,
    MatrixGroup,
    Product,
    Semidirect,
    Sphere,
    U,
    UnitQuaternion,
)

FRAMES = [
    SO3(), SO3("space"), SO(3), UnitQuaternion(),
    UnitQuaternion(scalar_first=True, convention="space"), SE3(), SE3("space"),
    Semidirect(SO3(), 2), Semidirect(SO(3, "space"), 3), Sphere(2), SU(2), SU(2, "body"), SO(2),
    SO(4), SO(5, "space"), SU(3), SU(4, "body"), SO(13), SU(13, "body"), U(1), U(3, "body"),
    Product(SU(3), Euclidean(1), SO(4)), Euclidean(4),
    Product(SO3(), Euclidean(3), Product(Sphere(2), SU(2), SE3())),
]  # fmt: skip
WEIGHTS = 0.75 * np.array([0.5, -1.25, 0.0625])[:, None]


def exact_exponential(x):
    with ctx.workdps(60):
        return doubles(flint_matrix(x).exp())


def exact_flow(frame, v, y):
    """Return one point after one flow, of a group or of y' = A y + b in the numbers of a point."""
    if isinstance(frame, MatrixGroup):
        return frame._multiply(exact_exponential(frame.algebra(v)), y)
    if isinstance(frame, HomogeneousSpace):
        return frame._act(exact_exponential(frame.group.algebra(v)), y)
    n = y.size
    images = frame.field(v, np.concatenate([np.zeros((1, n)), np.eye(n)]).reshape(-1, *y.shape))
    images = images.reshape(n + 1, n)
    matrix = np.zeros((n + 1, n + 1))
    matrix[:n, n], matrix[:n, :n] = images[0], (images[1:] - images[0]).T
    return (exact_exponential(matrix)[:n] @ np.append(y, 1.0)).reshape(y.shape)


def exact_flows(frame, vectors, points):
    """Return points after several flows, the first one first."""
    moved = np.array(points, dtype=frame.dtype)
    for index in np.ndindex(vectors.shape[:-2]):
        for v in vectors[index]:
            moved[index] = exact_flow(frame, v, moved[index])
    return moved


@pytest.mark.parametrize("batch", [(), (2, 1)], ids=repr)
@pytest.mark.parametrize("frame", [*FRAMES, *ORBITS], ids=repr)
def test_several_flows(frame, batch):
    rng = np.random.default_rng(5)
    points, vectors = frame.random_point(rng, batch), frame.random_vector(rng, (*batch, 3))
    vectors *= WEIGHTS
    before = points.copy()
    flows = compiled_flows(frame)
    expected = exact_flows(frame, vectors, points)
    size = max(1.0, np.abs(points).max())
    for restore in (False, True):
        moved = flows(vectors, points, restore)
        np.testing.assert_array_equal(points, before)
        np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-14 * size)
    assert frame.relative_error(moved).max() < (2e-15 if frame in ORBITS else 1e-15)


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e-154, 1e-9, 1e-4, 30.0, 3e3])
@pytest.mark.parametrize("name", STARTS)
def test_large_and_tiny_flows(name, size):
    frame, start = STARTS[name]
    v = size * np.resize([0.5, -1.0, 0.75], (1, frame.dim))
    moved, expected = compiled_flows(frame)(v, start, restore=False), exact_flows(frame, v, start)
    np.testing.assert_allclose(moved, expected, rtol=1e-14, atol=4e-15 * size)
    assert np.abs(moved - start).max() > (size / 8 if size < 1e-3 else 0.1)


CURVED = [
    SO3("space"), SO3(), UnitQuaternion(), Sphere(2), SU(2), SO(2), SO(4), SU(3), U(1),
    SE3(), SE3("space"),
]  # fmt: skip


@pytest.mark.parametrize("frame", CURVED, ids=repr)
def test_points_are_restored_to_the_nearest_ones(frame):
    rng = np.random.default_rng(11)
    points, off = frame.random_point(rng, 20), rng.standard_normal((2, 20, *frame.point_shape))
    if isinstance(frame, SE3):
        off[..., 3, :] = 0.0
    points = points + 1e-9 * (off[0] + 1j * off[1] if frame.dtype.kind == "c" else off[0])
    vectors = WEIGHTS * frame.random_vector(rng, (20, 3))
    moved, nearest = (compiled_flows(frame)(vectors, y) for y in (points, frame.project(points)))
    # the rotation of an SE3 moves translations before it is restored
    rounding = 1e-8 if isinstance(frame, SE3) else 1e-14
    np.testing.assert_allclose(moved, nearest, rtol=0, atol=rounding)
    assert frame.membership_error(moved).max() < 1e-15


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-12, 1e-4, 1.0, 3.0])
@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_compiled_differences(frame, size):
    rng = np.random.default_rng(8)
    points, v = frame.random_point(rng, (2, 50)), frame.random_vector(rng, (2, 50))
    v *= size / np.linalg.norm(v, axis=-1, keepdims=True)
    moved = frame.flow(v, points)
    actual, expected = difference_of(frame)(points, moved), frame.exp_coordinates(points, moved)
    # a translation may be as long as the points are, for which the roundings grow
    np.testing.assert_allclose(actual, expected, rtol=0, atol=5e-15 * max(1.0, size / 2))
    if size < 2.0:
        np.testing.assert_allclose(frame.flow(actual, points), moved, rtol=0, atol=1e-14)


@pytest.mark.parametrize("frame", [SO3(), SE3(), UnitQuaternion(), SU(2)], ids=repr)
def test_coordinates_of_half_turns(frame):
    rng = np.random.default_rng(9)
    axes = np.concatenate([np.eye(3), rng.standard_normal((40, 3))])
    v = np.zeros((43, frame.dim))
    v[:, :3] = np.pi * axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    y0 = frame.random_point(rng)
    y1 = frame.flow(v, y0)
    actual = frame.exp_coordinates(y0, y1)
    np.testing.assert_allclose(np.linalg.norm(actual[:, :3], axis=-1), np.pi, rtol=1e-14)
    np.testing.assert_allclose(frame.flow(actual, y0), y1, rtol=0, atol=2e-14)
