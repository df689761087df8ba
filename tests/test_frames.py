"""Axioms that every frame must satisfy, and the facts particular to each."""

import numpy as np
import pytest
from flint import arb_mat, ctx
from hypothesis import given, settings
from hypothesis import strategies as st

from cg.frames import SO3, Euclidean, Frame, Product, hat, vee

FRAMES = [
    SO3(),
    SO3("space"),
    Euclidean(1),
    Euclidean(4),
    Product(SO3()),
    Product(SO3(), Euclidean(3)),
    Product(Euclidean(2), Product(SO3("space"), SO3()), Euclidean(1)),
]
CONVENTIONS = ["body", "space"]
every_frame = pytest.mark.parametrize("frame", FRAMES, ids=repr)
seeds = st.integers(0, 2**32 - 1)
# From far below the square root of the smallest number to several turns.
scales = st.sampled_from([0.0, 1e-300, 1e-160, 1e-20, 1e-9, 1e-8, 1e-5, 1e-3, 0.1, 1.0, 3.0, 30.0])
axioms = settings(max_examples=40, deadline=None)


def sample(frame: Frame, seed: int, scale: float):
    rng = np.random.default_rng(seed)
    return frame.random_point(rng), scale * frame.random_vector(rng)


@every_frame
@axioms
@given(seed=seeds, scale=scales)
def test_flow_stays_on_the_manifold(frame, seed, scale):
    y, v = sample(frame, seed, scale)
    assert frame.membership_error(y) < 2e-15
    assert frame.membership_error(frame.flow(v, y)) < 2e-15


@every_frame
@axioms
@given(seed=seeds, scale=scales, s=st.floats(-2, 2), t=st.floats(-2, 2))
def test_flow_is_a_one_parameter_group(frame, seed, scale, s, t):
    y, v = sample(frame, seed, scale)
    rounding = 1e-14 * (1 + scale)
    np.testing.assert_allclose(frame.flow(0 * v, y), y, rtol=0, atol=4e-15)
    two = frame.flow(s * v, frame.flow(t * v, y))
    np.testing.assert_allclose(frame.flow((s + t) * v, y), two, rtol=0, atol=rounding)
    np.testing.assert_allclose(frame.flow(-v, frame.flow(v, y)), y, rtol=0, atol=rounding)


@every_frame
@axioms
@given(seed=seeds, scale=scales)
def test_derivative_of_the_flow_is_the_field(frame, seed, scale):
    y, v = sample(frame, seed, 1.0)
    v /= np.linalg.norm(v)
    here = frame.flow(scale * v, y)
    step = 1e-3
    near = [frame.flow((scale + k * step) * v, y) for k in (-2, -1, 1, 2)]
    derivative = (near[0] - 8 * near[1] + 8 * near[2] - near[3]) / (12 * step)
    np.testing.assert_allclose(derivative, frame.field(v, here), rtol=0, atol=3e-11 * (1 + scale))


@every_frame
@axioms
@given(seed=seeds, factor=st.floats(-5, 5))
def test_field_is_linear_in_the_coefficients(frame, seed, factor):
    rng = np.random.default_rng(seed)
    y, u, v = frame.random_point(rng), frame.random_vector(rng), frame.random_vector(rng)
    combined = frame.field(u, y) + factor * frame.field(v, y)
    np.testing.assert_allclose(frame.field(u + factor * v, y), combined, atol=1e-13)


@every_frame
def test_batches_agree_with_single_points(frame):
    rng = np.random.default_rng(3)
    y, v = frame.random_point(rng, (2, 3)), frame.random_vector(rng, (2, 3))
    x = frame.random_point(rng, (2, 3))
    assert y.shape == (2, 3, *frame.point_shape)
    assert v.shape == (2, 3, frame.dim)
    for index in np.ndindex(2, 3):
        single = frame.flow(v[index], y[index])
        np.testing.assert_allclose(frame.flow(v, y)[index], single, rtol=0, atol=4e-15)
        np.testing.assert_allclose(frame.field(v, y)[index], frame.field(v[index], y[index]))
        assert frame.distance(x, y)[index] == pytest.approx(
            float(frame.distance(x[index], y[index]))
        )
        error = float(frame.membership_error(y[index]))
        assert frame.membership_error(y)[index] == pytest.approx(error, abs=4e-15)
    many = frame.flow(v, y[0, 0])
    assert many.shape == (2, 3, *frame.point_shape)
    np.testing.assert_allclose(many[1, 2], frame.flow(v[1, 2], y[0, 0]), atol=4e-15)
    assert frame.flow(v[0, 0], y).shape == (2, 3, *frame.point_shape)


@every_frame
def test_distance_is_a_metric(frame):
    rng = np.random.default_rng(4)
    x, y, z = (frame.random_point(rng, (50,)) for _ in range(3))
    np.testing.assert_array_equal(frame.distance(x, x), np.zeros(50))
    np.testing.assert_allclose(frame.distance(x, y), frame.distance(y, x))
    assert (frame.distance(x, z) <= frame.distance(x, y) + frame.distance(y, z) + 1e-14).all()


@every_frame
def test_inputs_are_left_alone_and_outputs_are_new(frame):
    rng = np.random.default_rng(5)
    y, v = frame.random_point(rng), frame.random_vector(rng)
    y.flags.writeable = v.flags.writeable = False
    for result in (frame.flow(v, y), frame.field(v, y), frame.flow(0 * v, y), frame.check_point(y)):
        assert not np.shares_memory(result, y)
        assert not np.shares_memory(result, v)


@every_frame
def test_wrong_shapes_are_refused(frame):
    rng = np.random.default_rng(6)
    y, v = frame.random_point(rng), frame.random_vector(rng)
    for operation in (frame.flow, frame.field):
        with pytest.raises(ValueError, match=r"v must have shape"):
            operation(np.append(v, 1.0), y)
        with pytest.raises(ValueError, match=r"y must have shape"):
            operation(v, np.append(y, 1.0))
        with pytest.raises(ValueError, match=r"v must have shape"):
            operation(1.0, y)
    with pytest.raises(ValueError, match=r"x must have shape"):
        frame.distance(np.append(y, 1.0), y)
    with pytest.raises(ValueError, match=r"y must have shape"):
        frame.membership_error(1.0)


@every_frame
def test_frames_are_values(frame):
    copy = eval(repr(frame))
    assert copy == frame
    assert hash(copy) == hash(frame)
    assert sum(other == frame for other in FRAMES) == 1
    for name in ("n", "convention", "factors"):
        if hasattr(frame, name):
            with pytest.raises(AttributeError):
                setattr(frame, name, None)


@pytest.mark.parametrize("convention", CONVENTIONS)
@axioms
@given(seed=seeds, scale=st.sampled_from([0.0, 1e-9, 1e-4, 1e-2, 1.0, 3.0]))
def test_so3_flow_is_the_matrix_exponential(convention, seed, scale):
    frame = SO3(convention)
    y, v = sample(frame, seed, scale)
    with ctx.workprec(120):
        rotation = np.array(arb_mat(hat(v).tolist()).exp().tolist(), dtype=float)
    wanted = y @ rotation if convention == "body" else rotation @ y
    rounding = 1e-15 * (1 + np.linalg.norm(v))
    np.testing.assert_allclose(frame.flow(v, y), wanted, rtol=0, atol=rounding)


@pytest.mark.parametrize("angle", [1e-300, 1e-170, 1e-155, 1e-30, 1e-12, 1e-8, 1e-6, 1e-4, 1e-3])
def test_small_rotations_are_right_to_the_last_digit(angle):
    rotation = SO3().flow([angle, 0.0, 0.0], np.eye(3))
    sine = angle - angle**3 / 6 + angle**5 / 120
    assert rotation[2, 1] == pytest.approx(sine, rel=5e-16, abs=0)
    assert rotation[1, 2] == -rotation[2, 1]
    assert 1 - rotation[1, 1] == pytest.approx(angle**2 / 2 - angle**4 / 24, abs=2.3e-16)


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("kind", ["random", "constant"])
def test_rotations_do_not_drift(convention, kind):
    frame = SO3(convention)
    rng = np.random.default_rng(7)
    y = frame.random_point(rng)
    vectors = (
        frame.random_vector(rng, (10_000,)) if kind == "random" else np.full((10_000, 3), 0.07)
    )
    worst = 0.0
    for v in vectors:
        y = frame.flow(v, y)
        worst = max(worst, abs(y.T @ y - np.eye(3)).max())
    assert worst < 3e-15
    assert frame.membership_error(y) < 2e-15


def test_so3_membership_error_by_known_distances():
    frame = SO3()
    rotation = frame.random_point(np.random.default_rng(8))
    assert frame.membership_error(1.001 * rotation) == pytest.approx(1e-3, rel=1e-10)
    assert frame.membership_error(np.diag([1.0, 1.0, -1.0])) == pytest.approx(2.0)
    assert frame.membership_error(-rotation) == pytest.approx(2.0)
    assert frame.membership_error(np.zeros((3, 3))) == pytest.approx(1.0)
    sheared = np.array([[1.0, 1e-6, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert frame.membership_error(sheared) == pytest.approx(5e-7, rel=1e-5)


def test_so3_distance_is_the_angle():
    frame = SO3()
    y = frame.random_point(np.random.default_rng(9))
    for angle in (1e-12, 1e-3, 1.0, 3.0):
        moved = frame.flow(angle * np.array([0.6, 0.0, -0.8]), y)
        assert frame.distance(y, moved) == pytest.approx(angle, rel=1e-3 if angle < 1e-9 else 1e-12)


def test_random_rotations_are_uniform():
    points = SO3().random_point(np.random.default_rng(10), (20_000,))
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose((points**2).mean(axis=0), 1 / 3, atol=0.02)
    assert (np.linalg.det(points) > 0).all()


def test_hat_and_vee():
    rng = np.random.default_rng(11)
    v, x = rng.standard_normal((2, 5, 3))
    np.testing.assert_allclose((hat(v) @ x[..., None])[..., 0], np.cross(v, x), atol=1e-15)
    np.testing.assert_array_equal(vee(hat(v)), v)
    np.testing.assert_array_equal(vee(np.diag([1.0, 2.0, 3.0])), np.zeros(3))
    with pytest.raises(ValueError, match="v must have shape"):
        hat([1.0, 2.0])
    with pytest.raises(ValueError, match="matrix must have shape"):
        vee(np.eye(2))


def test_product_splits_what_it_joins():
    frame = Product(SO3(), Euclidean(3), SO3("space"))
    y = frame.random_point(np.random.default_rng(12), (4,))
    parts = frame.split(y)
    assert [part.shape for part in parts] == [(4, 3, 3), (4, 3), (4, 3, 3)]
    np.testing.assert_array_equal(frame.join(*parts), y)
    np.testing.assert_array_equal(frame.join(np.eye(3), [1, 2, 3], np.eye(3))[9:12], [1, 2, 3])
    with pytest.raises(ValueError, match="parts must be 3 points, got 1"):
        frame.join(np.eye(3))
    with pytest.raises(ValueError, match=r"parts\[1\] must have shape"):
        frame.join(np.eye(3), [1, 2], np.eye(3))


def test_product_adds_up_its_factors():
    frame = Product(SO3(), Euclidean(2))
    x = frame.join(np.eye(3), [0.0, 0.0])
    y = frame.join(SO3().flow([0.3, 0, 0], np.eye(3)), [0.0, 0.4])
    assert frame.distance(x, y) == pytest.approx(0.5)
    assert frame.membership_error(frame.join(2 * np.eye(3), [0.0, 0.4])) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: SO3("left"), ValueError, "convention must be"),
        (lambda: Euclidean(0), ValueError, "n must be a positive integer, got 0"),
        (lambda: Euclidean(2.0), ValueError, "n must be a positive integer"),
        (lambda: Euclidean(True), ValueError, "n must be a positive integer"),
        (Product, ValueError, "at least one frame"),
        (lambda: Product(SO3(), SO3), TypeError, r"factors\[1\] must be a Frame"),
    ],
)
def test_bad_frames_are_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (np.eye(2), r"start must have shape \(3, 3\), got \(2, 2\)"),
        (np.full((3, 3), np.nan), "start must be finite"),
        (1.5 * np.eye(3), r"start must be a point of SO3\(\): its distance .* is 0.5"),
        (1j * np.eye(3), "start must be an array of real numbers"),
        ("rotation", "start must be an array of real numbers"),
        ([[1, 2], [3]], "start must be an array of real numbers"),
    ],
)
def test_check_point_says_what_is_wrong(y, message):
    with pytest.raises(ValueError, match=message):
        SO3().check_point(y, name="start")


def test_check_point_takes_integers_and_the_tolerance():
    assert SO3().check_point(np.eye(3, dtype=int)).dtype == np.float64
    assert SO3().check_point(1.1 * np.eye(3), tolerance=0.2)[0, 0] == 1.1
