"""Projection to the nearest point of a manifold."""

import numpy as np
import pytest
from frame_examples import CIRCLE, ELLIPSE, FRAMES, OPEN, condition, name
from refusals import refuses

from cg import frames as fr

every_frame = pytest.mark.parametrize("frame", FRAMES, ids=name)


@every_frame
def test_off_manifold_errors_suggest_project(frame):
    if frame in OPEN:
        return
    rng = np.random.default_rng(93)
    off = frame.random_point(rng)
    off = off + 1e-4 * rng.standard_normal(off.shape)
    message = r"distance from the manifold is .*; frame\.project\(start\) is the nearest point"
    refuses(ValueError, message, frame.check_point, off, name="start")
    assert frame.relative_error(frame.check_point(frame.project(off))) < 1e-14


@pytest.mark.parametrize("frame", [
    fr.SU(2), fr.SU(3), fr.SL(2), fr.SL(3), fr.Sp(2), fr.Sp(4),
    fr.IsospectralOrbit((-1.0, 0.25, 1.5)),
    fr.SO3(), fr.SO(4), fr.U(3), fr.UnitQuaternion(), fr.Sphere(4), fr.Stiefel(4, 2),
    fr.CoadjointOrbit(fr.SL(2), (0.5, 0.25, 0.75)),
], ids=repr)  # fmt: skip
def test_projection_residual_is_normal_to_the_fields(frame):
    """This holds to first order, as after a few corrections of a nearby point."""
    rng = np.random.default_rng(95)
    on = frame.random_point(rng)
    off = on + 1e-4 * rng.standard_normal(on.shape)
    nearest = frame.project(off)
    left = (off - nearest).ravel()
    fields = frame.field(np.eye(frame.dim), nearest).reshape(frame.dim, -1)
    assert np.linalg.norm(left) > 1e-6
    assert np.abs((fields.conj() @ left).real).max() < 1e-6 * np.abs(fields).max()


@pytest.mark.parametrize("frame", [fr.SO(2), fr.SO3("space"), fr.SO(4)], ids=repr)
@pytest.mark.parametrize(("last", "got"), [(-0.9, "-0.9, of a left-"), (0.0, "0, of a singular")])
def test_matrices_that_are_not_right_handed_are_refused(frame, last, got):
    rng = np.random.default_rng(97)
    wrong = frame.random_point(rng) @ np.diag([1.0] * (frame.n - 1) + [last])
    y = frame.random_point(rng, (2, 3))
    y[1, 2] = wrong
    joint = fr.Product(fr.Euclidean(1), frame)
    line = np.zeros((2, 3, 1))
    message = "determinant .* got " + (got if last else "")
    refuses(ValueError, message, frame.project, wrong)
    refuses(ValueError, message, frame.project, y)
    refuses(ValueError, message, fr.Power(frame, 3).project, y)
    refuses(ValueError, message, joint.project, joint.join(line, y))
    refuses(ValueError, message, joint.check_point, joint.join([0.0], wrong))
    small = 1e-120 * frame.random_point(rng)  # whose determinant underflows
    assert frame.membership_error(frame.project(small)) < 1e-15


@every_frame
def test_projection_without_nearest_point_is_nan(frame):
    y = frame.random_point(np.random.default_rng(96), (2,))
    y[0].flat[0] = np.nan
    projected = frame.project(y)
    if frame not in OPEN:
        assert np.isnan(projected[0]).any()
    np.testing.assert_allclose(projected[1], y[1], rtol=0, atol=4e-15 * condition(y[1]))
    refuses(ValueError, "y must", frame.project, np.append(y[1], 1.0))


def test_user_projections():
    frame = fr.MatrixFrame(
        ELLIPSE.matrices, membership_error=lambda y: abs(np.sqrt(y[0] ** 2 + y[1] ** 2 / 4.0) - 1.0)
    )
    with pytest.raises(NotImplementedError, match="has a membership_error, but no project"):
        frame.project([1.1, 0.0])
    with pytest.raises(ValueError, match=r"distance from the manifold is 0\.1, more than 1e-08$"):
        frame.check_point([1.1, 0.0])
    np.testing.assert_allclose(ELLIPSE.project([1.1, 0.0]), [1.0, 0.0], rtol=1e-14)
    np.testing.assert_allclose(CIRCLE.project([[2.0], [3j]]), [[1.0], [1j]], rtol=1e-14)
    np.testing.assert_array_equal(fr.MatrixFrame([[[1.0]]]).project([[3.0]]), [[3.0]])
    refuses(TypeError, "project must", fr.MatrixFrame, [[[1.0]]], project=1)
    wrong = fr.FieldFrame([abs], abs, point_shape=2, project=lambda y: y[0])
    refuses(ValueError, "project must", wrong.project, [1.0, 2.0])
