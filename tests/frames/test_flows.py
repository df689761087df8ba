"""Compiled flows, several at once, against exponentials of the fields, which are linear."""

import numpy as np
import pytest
from compiled_examples import FRAMES as STARTS
from compiled_examples import ORBITS, compiled_flows, difference_of
from exact import doubles, flint_matrix
from flint import ctx

from cg import frames as fr
from cg.frames.blocks import constants_of
from cg.frames.facts import facts_of
from cg.support.shared_numbers import BlockKind

pytestmark = pytest.mark.sanitize

FRAMES = [
    fr.SO3(), fr.SO3("space"), fr.SO(3), fr.UnitQuaternion(),
    fr.UnitQuaternion(scalar_first=True, convention="space"), fr.SE3(), fr.SE3("space"),
    fr.Semidirect(fr.SO3(), 2), fr.Semidirect(fr.SO(3, "space"), 3), fr.Sphere(2), fr.SU(2),
    fr.SU(2, "body"), fr.SO(2), fr.SO(4), fr.SO(5, "space"), fr.SU(3), fr.SU(4, "body"), fr.SO(13),
    fr.SU(13, "body"), fr.U(1), fr.U(3, "body"), fr.Product(fr.SU(3), fr.Euclidean(1), fr.SO(4)),
    fr.Euclidean(4),
    fr.Product(fr.SO3(), fr.Euclidean(3), fr.Product(fr.Sphere(2), fr.SU(2), fr.SE3())),
]  # fmt: skip
WEIGHTS = 0.75 * np.array([0.5, -1.25, 0.0625])[:, None]


def exact_exponential(x):
    with ctx.workdps(60):
        return doubles(flint_matrix(x).exp())


def exact_flow(frame, v, y):
    """Return one point after one flow, of a group or of y' = A y + b in the numbers of a point."""
    if isinstance(frame, fr.MatrixGroup):
        return frame._multiply(exact_exponential(frame.algebra(v)), y)
    if isinstance(frame, fr.HomogeneousSpace):
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
    fr.SO3("space"), fr.SO3(), fr.UnitQuaternion(), fr.Sphere(2), fr.SU(2), fr.SO(2), fr.SO(4),
    fr.SU(3), fr.U(1), fr.SE3(), fr.SE3("space"),
]  # fmt: skip


@pytest.mark.parametrize("frame", CURVED, ids=repr)
def test_points_are_restored_to_the_nearest_ones(frame):
    rng = np.random.default_rng(11)
    points, off = frame.random_point(rng, 20), rng.standard_normal((2, 20, *frame.point_shape))
    if isinstance(frame, fr.SE3):
        off[..., 3, :] = 0.0
    points = points + 1e-9 * (off[0] + 1j * off[1] if frame.dtype.kind == "c" else off[0])
    vectors = WEIGHTS * frame.random_vector(rng, (20, 3))
    moved, nearest = (compiled_flows(frame)(vectors, y) for y in (points, frame.project(points)))
    # the rotation of an SE3 moves translations before it is restored
    rounding = 1e-8 if isinstance(frame, fr.SE3) else 1e-14
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


@pytest.mark.parametrize("frame", [fr.SO3(), fr.SE3(), fr.UnitQuaternion(), fr.SU(2)], ids=repr)
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


def test_which_orbits_are_compiled():
    orbit = fr.IsospectralOrbit((4.0, 1.0, 2.0))
    assert orbit.compiled_blocks() == ((BlockKind.ISOSPECTRAL, 3, 0, 1.0, 2.0, 4.0),)
    blocks = fr.Product(orbit, orbit).compiled_blocks()
    assert constants_of(blocks).tolist() == [1.0, 2.0, 4.0, 1.0, 2.0, 4.0, 0.0]
    assert all(facts_of(frame).compiled for frame in ORBITS)
    # errors of rotations are angles, those of these matrices are differences of entries
    assert not facts_of(fr.Product(orbit, fr.SO3())).compiled
    assert not facts_of(fr.Product(fr.Euclidean(1), fr.Product(orbit))).compiled
    assert not facts_of(fr.IsospectralOrbit((1.0, 2.0), hermitian=True)).compiled
    assert not facts_of(type("Child", (fr.IsospectralOrbit,), {})((1.0, 2.0))).compiled


@pytest.mark.parametrize("scale", [0.0, 1e-300, 1e-12, 1e12, 1e300])
def test_units_of_points_of_orbits_make_no_difference(scale):
    unit, scaled = (fr.IsospectralOrbit(tuple(s * np.array([1.0, 2.0, 4.0]))) for s in (1.0, scale))
    rng = np.random.default_rng(3)
    v, y = rng.standard_normal((4, 2, 3)), unit.random_point(rng, 4)
    moved = compiled_flows(scaled)(v, scale * y)
    np.testing.assert_allclose(
        moved, scale * compiled_flows(unit)(v, y), rtol=0, atol=1e-14 * scale
    )
