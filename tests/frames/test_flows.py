"""Compiled flows of several fields agree with the frame's flows."""

import numpy as np
import pytest
from compiled_differences import difference_of
from compiled_examples import FRAMES as STARTS
from compiled_examples import ORBITS

from cg.frames import SE3, SO, SO3, SU, Euclidean, Product, Semidirect, Sphere, U, UnitQuaternion
from cg.integration.step.flows import Flows, _CompiledFlows, flows_of

FRAMES = [
    SO3(), SO3("space"), SO(3), UnitQuaternion(),
    UnitQuaternion(scalar_first=True, convention="space"), SE3(), SE3("space"),
    Semidirect(SO3(), 2), Semidirect(SO(3, "space"), 3), Sphere(2), SU(2), SU(2, "body"), SO(2),
    SO(4), SO(5, "space"), SU(3), SU(4, "body"), SO(13), SU(13, "body"), U(1), U(3, "body"),
    Product(SU(3), Euclidean(1), SO(4)), Euclidean(4),
    Product(SO3(), Euclidean(3), Product(Sphere(2), SU(2), SE3())),
]  # fmt: skip
WEIGHTS = 0.75 * np.array([0.5, -1.25, 0.0625])[:, None]


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)], ids=repr)
@pytest.mark.parametrize("frame", [*FRAMES, *ORBITS], ids=repr)
def test_compiled_flows_match_frames(frame, batch):
    rng = np.random.default_rng(5)
    points = frame.random_point(rng, batch)
    before = points.copy()
    fields = frame.random_vector(rng, (*batch, 3))
    flows = flows_of(frame)
    assert isinstance(flows, _CompiledFlows)
    expected = Flows(frame)(WEIGHTS * fields, points)
    size = max(1.0, np.abs(points).max())
    for restore in (False, True):
        moved = flows(WEIGHTS * fields, points, restore)
        np.testing.assert_array_equal(points, before)
        np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-14 * size)
    assert frame.relative_error(moved).max() < (2e-15 if frame in ORBITS else 1e-15)


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e-154, 1e-9, 1e-4, 30.0, 3e3])
@pytest.mark.parametrize("name", STARTS)
def test_large_and_tiny_flows(name, size):
    frame, start = STARTS[name]
    v = size * np.resize([0.5, -1.0, 0.75], (1, frame.dim))
    moved, expected = flows_of(frame)(v, start, restore=False), Flows(frame)(v, start)
    np.testing.assert_allclose(moved, expected, rtol=1e-14, atol=4e-15 * size)
    assert np.abs(moved - start).max() > (size / 8 if size < 1e-3 else 0.1)


CURVED = [SO3("space"), SO3(), UnitQuaternion(), Sphere(2), SU(2), SO(2), SO(4), SU(3), U(1)]


@pytest.mark.parametrize("frame", [*CURVED, SE3(), SE3("space")], ids=repr)
def test_compiled_flows_restore_points_like_frames(frame):
    rng = np.random.default_rng(11)
    points, fields = frame.random_point(rng, (20,)), frame.random_vector(rng, (20, 3))
    off = rng.standard_normal((2, *points.shape))
    off = off[0] + 1j * off[1] if frame.dtype.kind == "c" else off[0]
    if isinstance(frame, SE3):
        off[..., 3, :] = off[..., :, 3] = 0.0  # of the rotation; its error moves translations
    both = flows_of(frame), Flows(frame)
    moved, expected = (flows(WEIGHTS * fields, points + 1e-9 * off) for flows in both)
    rounding = [1e-14, 1e-14, 1e-14, 1e-8] if isinstance(frame, SE3) else 1e-14
    assert (np.abs(moved - expected) <= rounding).all()
    assert frame.membership_error(moved).max() < 1e-15


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-12, 1e-4, 1.0, 3.0])
@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_compiled_differences_match_frames(frame, size):
    rng = np.random.default_rng(8)
    points = frame.random_point(rng, (2, 50))
    v = frame.random_vector(rng, (2, 50))
    v *= size / np.linalg.norm(v, axis=-1, keepdims=True)
    moved = frame.flow(v, points)
    actual = difference_of(frame)(points, moved)
    expected = frame.exp_coordinates(points, moved)
    # a translation may be as long as the points are, for which the roundings grow
    np.testing.assert_allclose(actual, expected, rtol=0, atol=5e-15 * max(1.0, size / 2))
    if size < 2.0:
        np.testing.assert_allclose(frame.flow(actual, points), moved, rtol=0, atol=1e-14)


def half_turns():
    rng = np.random.default_rng(9)
    axes = rng.standard_normal((40, 3))
    axes = np.concatenate([np.eye(3), axes / np.linalg.norm(axes, axis=-1, keepdims=True)])
    return np.pi * axes


@pytest.mark.parametrize("frame", [SO3(), SE3(), UnitQuaternion(), SU(2)], ids=repr)
def test_compiled_differences_of_half_turns(frame):
    v = np.zeros((43, frame.dim))
    v[:, :3] = half_turns()
    y0 = frame.random_point(np.random.default_rng(10))
    y1 = frame.flow(v, np.broadcast_to(y0, (43, *y0.shape)))
    actual = difference_of(frame)(np.broadcast_to(y0, y1.shape), y1)
    np.testing.assert_allclose(np.linalg.norm(actual[:, :3], axis=-1), np.pi, rtol=1e-14)
    np.testing.assert_allclose(frame.flow(actual, y0), y1, rtol=0, atol=2e-14)


MATRICES = [SO(2), SO(4), SO(5, "space"), SU(3), SU(4, "body"), U(1), U(3, "body")]


@pytest.mark.parametrize("size", [10.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("frame", MATRICES, ids=repr)
def test_large_turns_stay_on_the_group(frame, size):
    rng = np.random.default_rng(4)
    y, v = frame.random_point(rng, 10), frame.random_vector(rng, 10)
    v *= size / np.linalg.norm(v, axis=-1, keepdims=True)
    moved = flows_of(frame)(v[:, None], y)
    assert frame.membership_error(moved).max() < 2e-15
    np.testing.assert_allclose(moved, frame.flow(v, y), rtol=0, atol=3e-15 * size)
