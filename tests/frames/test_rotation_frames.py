"""Closed forms of frames of rotations against independent computations."""

import numpy as np
import pytest
from frame_examples import sample
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refuses
from scipy.spatial.transform import Rotation

import cg
from cg.frames import SE3, SO, SO3, SU, UnitQuaternion, hat, vee

CONVENTIONS = ["body", "space"]
seeds = st.integers(0, 2**32 - 1)
axioms = settings(max_examples=40, deadline=None)


def test_hat_and_vee():
    rng = np.random.default_rng(11)
    v, x = rng.standard_normal((2, 5, 3))
    np.testing.assert_allclose((hat(v) @ x[..., None])[..., 0], np.cross(v, x), rtol=0, atol=2e-14)
    np.testing.assert_array_equal(vee(hat(v)), v)
    np.testing.assert_array_equal(vee(np.diag([1.0, 2.0, 3.0])), np.zeros(3))
    refuses(ValueError, "v must", hat, [1.0, 2.0])
    refuses(ValueError, "matrix must", vee, np.eye(2))


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("scalar_first", [False, True])
@axioms
@given(seed=seeds, scale=st.sampled_from([0.0, 1e-160, 1e-9, 1e-4, 1.0, 3.0, 10.0]))
def test_quaternions_agree_with_scipy_and_with_so3(convention, scalar_first, seed, scale):
    frame = UnitQuaternion(convention, scalar_first=scalar_first)
    y, v = sample(frame, seed, scale)
    before = Rotation.from_quat(y, scalar_first=scalar_first)
    turn = Rotation.from_rotvec(v)
    after = before * turn if convention == "body" else turn * before
    moved = frame.flow(v, y)
    rounding = 2e-15 * (1 + np.linalg.norm(v))
    np.testing.assert_allclose(
        Rotation.from_quat(moved, scalar_first=scalar_first).as_matrix(), after.as_matrix(), rtol=0,
        atol=rounding,
    )  # fmt: skip
    np.testing.assert_allclose(
        SO3(convention).flow(v, before.as_matrix()), after.as_matrix(), rtol=0, atol=rounding
    )
    other = UnitQuaternion(convention, scalar_first=not scalar_first)
    swapped = np.roll(y, -1 if scalar_first else 1)
    np.testing.assert_allclose(
        np.roll(other.flow(v, swapped), 1 if scalar_first else -1), moved, rtol=0, atol=3e-16
    )


def test_logarithms_of_half_and_full_turns():
    for axis in (*np.eye(3), [0.6, 0.0, -0.8], [-2 / 3, 1 / 3, 2 / 3]):
        turn = np.pi * np.array(axis)
        rotation = SO3().flow(turn, np.eye(3))
        coordinates = SO3().logarithm(rotation)
        assert np.linalg.norm(coordinates) == pytest.approx(np.pi, abs=1e-14)
        np.testing.assert_allclose(SO3().flow(coordinates, np.eye(3)), rotation, rtol=0, atol=1e-14)
    one = np.array([0.0, 0.0, 0.0, 1.0])
    full = UnitQuaternion().exp_coordinates(one, -one)
    np.testing.assert_allclose(full, [2 * np.pi, 0.0, 0.0], rtol=1e-14)
    np.testing.assert_allclose(SU(2).exp_coordinates(np.eye(2), -np.eye(2)), full, rtol=1e-14)
    assert UnitQuaternion().distance(one, -one) == pytest.approx(2 * np.pi, abs=5e-14)


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("scalar_first", [False, True])
def test_differences_of_attitudes(convention, scalar_first):
    """They are those of rotation matrices, whatever the signs of the quaternions."""
    frame, rng = UnitQuaternion(convention, scalar_first=scalar_first), np.random.default_rng(19)
    x, y = frame.random_point(rng, (2, 200))
    expected = SO3(convention).exp_coordinates(*(frame.as_rotation(q).as_matrix() for q in (x, y)))
    assert np.linalg.norm(expected, axis=-1).max() > 3.1
    for end in (y, -y, frame.as_rotation(y)):
        actual = frame.attitude_difference(x, end)
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(frame.attitude_difference(x, -x), np.zeros((200, 3)))
    refuses(ValueError, "y1 must", frame.attitude_difference, x, np.zeros(3))


ROTATION_FRAMES = [kind for c in CONVENTIONS for kind in (
    SO3(c), SO(3, c), UnitQuaternion(c), UnitQuaternion(c, scalar_first=True)
)]  # fmt: skip


def rotations_of_scipy(rng, *batch):
    return Rotation.from_rotvec(rng.standard_normal((*batch, 3)))


@pytest.mark.parametrize("batch", [(), (4,), (1,)], ids=repr)
@pytest.mark.parametrize("frame", ROTATION_FRAMES, ids=repr)
def test_scipy_rotations_are_accepted_as_points(frame, batch):
    rng = np.random.default_rng(23)
    rotation = rotations_of_scipy(rng, *batch)
    points = frame.read_points(rotation, "y0")
    assert points.shape == (*batch, *frame.point_shape)
    assert points.flags.c_contiguous
    assert points.flags.writeable
    assert frame.membership_error(points).max() < 1e-15
    np.testing.assert_array_equal(points, frame._points(rotation))
    v = rng.standard_normal(3)
    moved = frame.flow(v, rotation)
    np.testing.assert_array_equal(moved, frame.flow(v, points))
    turn = Rotation.from_rotvec(v)
    expected = rotation * turn if frame.convention == "body" else turn * rotation
    actual = frame.as_rotation(moved)
    assert isinstance(actual, Rotation)
    assert actual.single == (not batch)
    np.testing.assert_allclose(actual.as_matrix(), expected.as_matrix(), rtol=0, atol=3e-15)
    np.testing.assert_allclose(frame.distance(rotation, points), 0.0, rtol=0, atol=1e-15)
    if not batch:
        np.testing.assert_array_equal(frame.check_point(rotation), points)


class TestRigidTransforms:
    @pytest.fixture
    def transform(self):
        module = pytest.importorskip("scipy.spatial.transform")
        if not hasattr(module, "RigidTransform"):
            pytest.skip("SciPy has none before 1.16")
        return module.RigidTransform

    @pytest.mark.parametrize("frame", [SE3(), SE3("space")], ids=repr)
    def test_in_and_out(self, transform, frame):
        rng = np.random.default_rng(3)
        poses = frame.random_point(rng, 4)
        given = transform.from_matrix(poses)
        np.testing.assert_allclose(frame.read_points(given), poses, rtol=0, atol=1e-15)
        np.testing.assert_allclose(
            frame.as_rigid_transform(poses).as_matrix(), poses, rtol=0, atol=1e-14
        )
        run = cg.solve_ivp(lambda t, y: np.ones(6), (0, 1), given[0], frame=frame)
        assert isinstance(frame.as_rigid_transform(run.y), transform)
