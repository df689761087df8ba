"""Conversion of points to and from jaxlie; steps of both agree."""

from types import SimpleNamespace

import numpy as np
import pytest
from jax_setup import jax
from refusals import refuses
from scipy.spatial.transform import Rotation

import cg
from cg.frames import SE3, SO3, Euclidean, Product, Sphere, UnitQuaternion

jnp = jax.numpy
ROTATIONS = [SO3(), SO3("space"), UnitQuaternion(), UnitQuaternion("space", scalar_first=True)]
POSES = [SE3(), SE3("space"), Product(UnitQuaternion(), Euclidean(3))]


def numbers(seed=3):
    """Return a unit quaternion, scalar first and positive, and a position."""
    wxyz, xyz = np.split(np.random.default_rng(seed).standard_normal(7), [4])
    return np.concatenate([np.sign(wxyz[0]) * wxyz / np.linalg.norm(wxyz), xyz])


@pytest.mark.parametrize("frame", [*ROTATIONS, *POSES], ids=repr)
def test_there_and_back(frame):
    """Rotations are those of SciPy."""
    full = jnp.asarray(numbers())
    pose = SimpleNamespace(wxyz=full[:4], wxyz_xyz=full)
    y = cg.jax.from_jaxlie(frame, pose)
    assert y.shape == frame.point_shape
    if frame in ROTATIONS:
        expected = Rotation.from_quat(full[:4], scalar_first=True).as_matrix()
        matrix = y if y.ndim == 2 else frame.as_rotation(np.asarray(y)).as_matrix()
        np.testing.assert_allclose(matrix, expected, rtol=0.0, atol=1e-15)
    back = cg.jax.to_jaxlie(frame, y, np.asarray)
    np.testing.assert_allclose(back, full[: len(back)], rtol=0.0, atol=1e-15)


def test_derivatives_and_batches():
    frame = SE3()

    def position(v):
        y = cg.jax.flow(frame, v, jnp.eye(4))
        return cg.jax.to_jaxlie(frame, y, lambda full: full)

    slope = jax.jacfwd(position)(jnp.zeros(6))
    expected = np.zeros((7, 6))
    expected[1:4, :3] = 0.5 * np.eye(3)
    expected[4:, 3:] = np.eye(3)
    np.testing.assert_allclose(slope, expected, atol=1e-15)
    together = jnp.stack([jnp.asarray(numbers(seed)) for seed in range(3)])
    points = jax.vmap(lambda full: cg.jax.from_jaxlie(frame, SimpleNamespace(wxyz_xyz=full)))(
        together
    )
    assert points.shape == (3, 4, 4)


def test_bad_input():
    with pytest.raises(TypeError, match="frame must"):
        cg.jax.from_jaxlie(Sphere(2), SimpleNamespace(wxyz=np.ones(4)))
    refuses(TypeError, "pose must", cg.jax.from_jaxlie, SE3(), SimpleNamespace(wxyz=np.ones(4)))
    with pytest.raises(ValueError, match="wxyz must"):
        cg.jax.from_jaxlie(SO3(), SimpleNamespace(wxyz=np.ones((2, 4))))
    with pytest.raises(TypeError, match=r"got Product.*; cg\.jax\.join makes its point"):
        cg.jax.from_jaxlie(Product(SE3(), Euclidean(6)), SimpleNamespace(wxyz_xyz=np.ones(7)))
    with pytest.raises(TypeError, match=r"kind must have 7 parameters for SE3.*, with 4"):
        cg.jax.to_jaxlie(SE3(), np.eye(4), type("SO3", (), {"parameters_dim": 4}))
    refuses(ValueError, "y must", cg.jax.to_jaxlie, SE3(), np.eye(3), list)
