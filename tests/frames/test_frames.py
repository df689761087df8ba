"""Axioms that every frame must satisfy."""

import numpy as np
import pytest
from frame_examples import FLAT, FRAMES, OPEN, capped, condition, name, sample
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refuses

from cg import frames as fr
from cg.frames.user import UserFrame

pytestmark = pytest.mark.no_core

every_frame = pytest.mark.parametrize("frame", FRAMES, ids=name)
seeds = st.integers(0, 2**32 - 1)
# From far below the square root of the smallest number to several turns.
scales = st.sampled_from([0.0, 1e-300, 1e-160, 1e-20, 1e-9, 1e-8, 1e-5, 1e-3, 0.1, 1.0, 3.0, 30.0])
axioms = settings(max_examples=15, deadline=None)


def acts_freely(frame):
    """Return whether different small coefficients lead to different points."""
    if isinstance(frame, fr.Product):
        return all(map(acts_freely, frame.factors))
    return isinstance(frame, fr.MatrixGroup | fr.UnitQuaternion) or frame in FLAT


@every_frame
@axioms
@given(seed=seeds, scale=scales)
def test_flow_stays_on_the_manifold(frame, seed, scale):
    y, v = sample(frame, seed, scale)
    moved = frame.flow(v, y)
    assert y.dtype == moved.dtype == frame.dtype
    assert frame.membership_error(y) < 2e-15 * condition(y)
    assert frame.membership_error(moved) < 2e-15 * condition(y, moved)


@every_frame
@axioms
@given(seed=seeds)
def test_membership_error_of_perturbed_points(frame, seed):
    y = frame.random_point(np.random.default_rng(seed))
    n = y.size * (2 if y.dtype.kind == "c" else 1)
    axes = np.eye(n).view(y.dtype).reshape(n, *y.shape)
    errors = frame.membership_error(y + 0.02 * np.concatenate([axes, -axes]))
    if frame in OPEN:
        assert (errors == 0.0).all()
    else:
        # The squares of the axes' components along a unit normal add up to one, so that one of
        # the n components is 1 / sqrt(n) or more; terms of second order add to it there or the
        # other way. Where errors are 2-norms of matrices of n entries, or a determinant's over
        # their rows, they are less by up to sqrt(n), and those of the ellipse by 2.
        assert 0.02 / (2 * n * condition(y)) < errors.max() < 0.2 * condition(y)


@every_frame
@axioms
@given(seed=seeds, scale=scales, s=st.floats(-2, 2), t=st.floats(-2, 2))
def test_flow_is_a_one_parameter_group(frame, seed, scale, s, t):
    y, v = sample(frame, seed, scale)
    middle = frame.flow(t * v, y)
    two = frame.flow(s * v, middle)
    there = frame.flow(v, y)
    longest = np.linalg.norm(v) * (1 + abs(s) + abs(t))
    rounding = 1e-14 * (1 + longest) * condition(y, middle, two, there)
    np.testing.assert_allclose(frame.flow(0 * v, y), y, rtol=0, atol=4e-15 * condition(y))
    np.testing.assert_allclose(frame.flow((s + t) * v, y), two, rtol=0, atol=rounding)
    np.testing.assert_allclose(frame.flow(-v, there), y, rtol=0, atol=rounding)


@every_frame
@axioms
@given(seed=seeds, scale=scales)
def test_derivative_of_the_flow_is_the_field(frame, seed, scale):
    y, v = sample(frame, seed, 1.0)
    v /= np.linalg.norm(v)
    scale = capped(frame, scale)
    here = frame.flow(scale * v, y)
    step = 1e-3
    near = [frame.flow((scale + k * step) * v, y) for k in (-2, -1, 1, 2)]
    derivative = (near[0] - 8 * near[1] + 8 * near[2] - near[3]) / (12 * step)
    rounding = 3e-11 * (1 + scale) * condition(y, here)
    np.testing.assert_allclose(derivative, frame.field(v, here), rtol=0, atol=rounding)


@every_frame
@axioms
@given(seed=seeds, scale=scales)
def test_exp_coordinates_invert_the_flow(frame, seed, scale):
    scale = min(scale, 0.1)
    y, v = sample(frame, seed, scale)
    moved = frame.flow(v, y)
    coordinates = frame.exp_coordinates(y, moved)
    if coordinates is None:
        assert isinstance(frame, fr.HomogeneousSpace | UserFrame) or "Coadjoint" in repr(frame)
        return
    rounding = 1e-14 * condition(y, moved)
    np.testing.assert_allclose(frame.flow(coordinates, y), moved, rtol=0, atol=rounding)
    assert np.linalg.norm(coordinates) <= np.linalg.norm(v) + rounding
    if acts_freely(frame):
        np.testing.assert_allclose(coordinates, v, rtol=0, atol=rounding)


@every_frame
@axioms
@given(seed=seeds)
def test_exp_coordinates_of_arbitrary_points(frame, seed):
    rng = np.random.default_rng(seed)
    x, y = frame.random_point(rng), frame.random_point(rng)
    coordinates = frame.exp_coordinates(x, y)
    if coordinates is None or not np.isfinite(coordinates).all():
        return
    np.testing.assert_allclose(
        frame.flow(coordinates, x), y, rtol=0, atol=2e-14 * condition(x, y) ** 2
    )


def test_products_join_one_point_with_many():
    frame, one, many = fr.Product(fr.Sphere(2), fr.Euclidean(2)), [0.0, 0.6, 0.8], np.eye(3)
    points, vectors = frame.split(frame.join(one, np.ones((3, 2))))
    np.testing.assert_array_equal(points, [one] * 3)
    np.testing.assert_array_equal(vectors, np.ones((3, 2)))
    np.testing.assert_array_equal(frame.split(frame.join(many, [1.0, 2.0]))[1], [[1.0, 2.0]] * 3)


@every_frame
def test_batches_agree_with_single_points(frame):
    rng = np.random.default_rng(3)
    y, v = frame.random_point(rng, (2, 3)), frame.random_vector(rng, (2, 3))
    v *= capped(frame, 1.0)
    x = frame.random_point(rng, (2, 3))
    close = 1e-14 * condition(x, y)
    assert y.shape == (2, 3, *frame.point_shape)
    assert v.shape == (2, 3, frame.dim)
    moved, tangent, distance = frame.flow(v, y), frame.field(v, y), frame.distance(x, y)
    error, coordinates = frame.membership_error(x), frame.exp_coordinates(y, moved)
    assert moved.shape == tangent.shape == y.shape
    assert distance.shape == error.shape == (2, 3)
    for i in np.ndindex(2, 3):
        np.testing.assert_allclose(moved[i], frame.flow(v[i], y[i]), rtol=0, atol=close)
        np.testing.assert_allclose(tangent[i], frame.field(v[i], y[i]), rtol=0, atol=close)
        assert distance[i] == pytest.approx(float(frame.distance(x[i], y[i])), abs=close)
        assert error[i] == pytest.approx(float(frame.membership_error(x[i])), abs=close)
        if coordinates is not None:
            assert coordinates.shape == v.shape
            single = frame.exp_coordinates(y[i], moved[i])
            np.testing.assert_allclose(coordinates[i], single, rtol=0, atol=close)
    many = frame.flow(v, y[0, 0])
    assert many.shape == (2, 3, *frame.point_shape)
    np.testing.assert_allclose(many[1, 2], frame.flow(v[1, 2], y[0, 0]), rtol=0, atol=close)
    assert frame.flow(v[0, 0], y).shape == y.shape
    assert frame.field(v[0, 0], y).shape == y.shape
    assert frame.field(v, y[0, 0]).shape == y.shape
    assert frame.distance(x[0, 0], y).shape == (2, 3)
    if coordinates is not None:
        assert frame.exp_coordinates(y[0, 0], y).shape == v.shape
    empty = frame.flow(v[:0], y[:0])
    assert empty.shape == (0, 3, *frame.point_shape)


@every_frame
def test_rejects_wrong_shapes(frame):
    rng = np.random.default_rng(6)
    y, v = frame.random_point(rng), frame.random_vector(rng)
    long = np.append(y, 1.0)
    for operation in (frame.flow, frame.field):
        refuses(ValueError, "v must", operation, np.append(v, 1.0), y)
        refuses(ValueError, "y must", operation, v, long)
        refuses(ValueError, "v must", operation, 1.0, y)
    refuses(ValueError, "x must", frame.distance, long, y)
    refuses(ValueError, "y must", frame.membership_error, 1.0)
    refuses(ValueError, "y0 must", frame.exp_coordinates, long, y)
    refuses(ValueError, "y1 must", frame.exp_coordinates, y, long)


@every_frame
def test_overflow_gives_nonfinite_points(frame):
    rng = np.random.default_rng(7)
    y, v = frame.random_point(rng, (2,)), frame.random_vector(rng, (2,))
    v *= capped(frame, 1.0)
    alone = frame.flow(v[1], y[1])
    y[0].flat[0] = np.nan
    moved = frame.flow(v, y)
    assert not np.isfinite(moved[0]).all()
    np.testing.assert_allclose(moved[1], alone, rtol=1e-14, atol=1e-14)


@every_frame
def test_frames_compare_by_value(frame):
    if not isinstance(frame, fr.FieldFrame | fr.MatrixFrame):
        copy = eval(repr(frame), {name: getattr(fr, name) for name in fr.__all__})
        assert copy == frame
        assert hash(copy) == hash(frame)
    assert sum(other == frame for other in FRAMES) == 1
    for attribute in ("n", "convention", "factors", "_flow", "_matrices"):
        if hasattr(frame, attribute):
            with pytest.raises(AttributeError):
                setattr(frame, attribute, None)


@every_frame
@axioms
@given(seed=seeds, scale=st.sampled_from([0.0, 1e-160, 1e-9, 1.0, 30.0]))
def test_coefficients_invert_fields(frame, seed, scale):
    y, v = sample(frame, seed, scale)
    tangent = frame.field(v, y)
    found = frame.coefficients(y, tangent)
    rounding = 1e-13 * (np.abs(tangent).max() + scale) * condition(y)
    np.testing.assert_allclose(frame.field(found, y), tangent, rtol=0, atol=rounding)
    assert np.linalg.norm(found) <= np.linalg.norm(v) * (1 + 1e-12) + rounding * condition(y)
    stack = frame.coefficients(y, np.stack([tangent, 2.0 * tangent])[:, None])
    assert stack.shape == (2, 1, frame.dim)
    np.testing.assert_allclose(stack[:, 0], [found, 2.0 * found], rtol=1e-14, atol=rounding / 20)


@every_frame
def test_coefficients_drop_what_no_field_has(frame):
    rng = np.random.default_rng(0)
    y = frame.random_point(rng)
    tangent, other = frame.field(frame.random_vector(rng), y), frame.random_point(rng)
    assert np.isnan(frame.coefficients(y, np.full_like(y, np.nan))).any()
    basis = frame.field(np.eye(frame.dim), y).reshape(frame.dim, -1).view(float)
    flat = other.reshape(-1).view(float)
    normal = flat - flat @ np.linalg.pinv(basis, rcond=1e-9) @ basis
    if np.linalg.norm(normal) > 1e-6 * np.linalg.norm(flat):
        wrong = tangent + normal.view(frame.dtype).reshape(y.shape)
        with pytest.warns(UserWarning, match="a part that the fields of .* don't have"):
            frame.coefficients(y, wrong)
