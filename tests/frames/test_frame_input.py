"""Bad input to frames, refused by its name; and odd, but honest input, taken as it is meant."""

import warnings

import numpy as np
import pytest
from frame_examples import FRAMES, name

from cg.frames import (
    GL,
    SL,
    SO,
    SO3,
    SU,
    CoadjointOrbit,
    Euclidean,
    FieldFrame,
    IsospectralOrbit,
    MatrixFrame,
    Product,
    Semidirect,
    Sp,
    Sphere,
    Stiefel,
    U,
    UnitQuaternion,
)
from cg.frames.matrix_group import MatrixGroup
from cg.problems import AffineField, ForcedRigidBody, FreeRigidBody

pytestmark = pytest.mark.no_core

MASKED = np.ma.masked_array([1.0, 2.0, 3.0], mask=[1, 0, 0])


@pytest.mark.parametrize(
    "v",
    [
        ["1", "0", "0"],
        [True, False, False],
        [1j, 0, 0],
        MASKED,
        np.array(["2020-01-01"] * 3, dtype="M8[D]"),
        [10**400, 0, 0],
        {1, 2, 3},
        "abc",
    ],
)
@pytest.mark.parametrize("method", ["flow", "field"])
def test_rejects_nonnumeric_coefficients(v, method):
    for frame, y in [(SO3(), np.eye(3)), (Sphere(2), [0, 0, 1]), (SU(2), np.eye(2))]:
        with pytest.raises(ValueError, match="v must be an array of real numbers, got"):
            getattr(frame, method)(v, y)


@pytest.mark.parametrize(
    "y",
    [
        1j * np.eye(3),
        np.eye(3, dtype=bool),
        np.ma.masked_array(np.eye(3), mask=np.eye(3)),
        np.eye(3).astype(str),
    ],
)
def test_rejects_nonnumeric_points(y):
    frame = SO3()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for call in (
            lambda: frame.flow([1, 0, 0], y),
            lambda: frame.field([1, 0, 0], y),
            lambda: frame.distance(np.eye(3), y),
            lambda: frame.membership_error(y),
            lambda: frame.check_point(y),
        ):
            with pytest.raises(ValueError, match="y must be an array of real numbers, got"):
                call()
        with pytest.raises(ValueError, match="y0 must be an array of real numbers, got"):
            frame.exp_coordinates(y, np.eye(3))


def test_accepts_unusual_array_types():
    frame, v = SO3(), [0.5, -0.25, 1.0]
    y = frame.flow([1.0, 2.0, 3.0], np.eye(3))
    wanted = frame.flow(v, y)
    readonly = y.copy()
    readonly.flags.writeable = False
    wide = np.zeros((6, 6))
    wide[::2, ::2] = y
    for odd in (readonly, wide[::2, ::2], np.asfortranarray(y), y.tolist(), y.astype(object)):
        np.testing.assert_array_equal(frame.flow(v, odd), wanted)
    np.testing.assert_array_equal(frame.flow(np.ma.masked_array(v), y), wanted)
    np.testing.assert_array_equal(frame.flow(np.float32(v), y), wanted)
    np.testing.assert_array_equal(frame.flow([1, 2, 3], np.eye(3, dtype=int)), y)
    assert frame.flow(np.zeros((0, 3)), y).shape == (0, 3, 3)


@pytest.mark.parametrize("tolerance", [np.nan, -1.0, "x", None, True, 1j])
def test_tolerance(tolerance):
    with pytest.raises(ValueError, match="tolerance must be a non-negative number, got"):
        SO3().check_point(np.eye(3), tolerance=tolerance)


@pytest.mark.parametrize(
    "make",
    [SO, SU, U, GL, SL, Sp, Sphere, Euclidean, lambda n: Stiefel(n, n), lambda n: Stiefel(4, n)],
)
def test_sizes_accept_numpy_integers(make):
    assert make(np.int64(2)) == make(2)
    assert repr(make(np.int64(2))) == repr(make(2))
    with pytest.raises(TypeError, match=r"must be an integer, got np\.True_"):
        make(np.True_)


def test_other_sizes_accept_numpy_integers():
    two = np.int64(2)
    assert Semidirect(SO3(), two) == Semidirect(SO3(), 2)
    assert MatrixFrame([[[1.0]]], two) == MatrixFrame([[[1.0]]], 2)
    for shape in (two, [two], np.array([2])):
        assert field_frame(point_shape=shape).point_shape == (2,)


def field_frame(**changes):
    given = {"fields": [lambda y: y], "flow": lambda v, y: np.exp(v[0]) * y, "point_shape": 1}
    return FieldFrame(**given | changes)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"fields": None}, TypeError, "fields must be a sequence of functions, got None"),
        ({"fields": abs}, TypeError, "fields must be a sequence of functions, got <built-in"),
        ({"point_shape": None}, TypeError, "point_shape must be an integer, got None"),
        ({"point_shape": 1.0}, TypeError, r"point_shape must be an integer, got 1\.0"),
        ({"point_shape": np.nan}, TypeError, "point_shape must be an integer, got nan"),
    ],
)
def test_field_frame_rejects_bad_arguments(changes, error, message):
    with pytest.raises(error, match=message):
        field_frame(**changes)


def test_conventions_must_be_strings():
    with pytest.raises(ValueError, match=r'convention must be "body" or "space", got array'):
        UnitQuaternion(np.array(["body"]))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MatrixFrame([[[True]]]), "matrices must be an array of real numbers"),
        (lambda: MatrixFrame([[[np.nan]]]), r"matrices must be finite, got nan at \[0, 0, 0\]"),
        (
            lambda: CoadjointOrbit(np.full((3, 3, 3), np.inf), (1, 2, 3)),
            r"algebra must be finite, got inf at \[0, 0, 0\]",
        ),
        (lambda: IsospectralOrbit(MASKED), "spectrum must be an array of real numbers"),
        (lambda: CoadjointOrbit(SO3(), MASKED), "point must be an array of real numbers"),
        (lambda: FreeRigidBody(inertia=MASKED), "inertia must be an array of real numbers"),
        (
            lambda: ForcedRigidBody(frequency=True),
            "frequency must be an array of real numbers, got",
        ),
        (
            lambda: Product(SO3(), SO3()).join(np.zeros((2, 3, 3)), np.zeros((3, 3, 3))),
            r"parts must have leading axes that broadcast, got \[\(2,\), \(3,\)\]",
        ),
    ],
)
def test_parameters(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_affine_fields():
    with pytest.raises(TypeError, match=r"frame must be a Frame such as SO3\(\), got 3"):
        AffineField(3, [1.0])
    with pytest.raises(TypeError, match="seed must be an integer, got True"):
        AffineField(SO3(), np.eye(3), seed=True)


@pytest.mark.parametrize("method", ["random_point", "random_vector"])
@pytest.mark.parametrize("frame", FRAMES, ids=name)
def test_random_points_and_vectors(frame, method):
    draw = getattr(frame, method)
    rng = np.random.default_rng
    for wrong in (0, None, "seed", np.random, np.random.RandomState(0)):
        with pytest.raises(TypeError, match=r"rng must be a generator such as .*, got"):
            draw(wrong)
    for size in (1.5, "2", None, (2, 1.5), True, (True,), {2}, [[2]]):
        with pytest.raises(TypeError, match="size must be an integer or a tuple"):
            draw(rng(0), size)
    for size in (-1, (2, -1)):
        with pytest.raises(ValueError, match="size must not be negative, got"):
            draw(rng(0), size)
    wanted = draw(rng(0), (3,))
    for size in (3, [3], np.int64(3), (np.int64(3),)):
        np.testing.assert_array_equal(draw(rng(0), size), wanted)
    assert len(draw(rng(0), 0)) == 0


@pytest.mark.parametrize("frame", FRAMES, ids=name)
def test_dimensions_of_groups(frame):
    if isinstance(frame, MatrixGroup):
        assert len(frame.basis) == frame.dim


@pytest.mark.parametrize(
    ("frame", "dim"),
    [
        (SO(10**6), 499999500000),
        (Sphere(10**6), 500000500000),
        (Stiefel(10**6, 2), 499999500000),
        (SU(10**6), 999999999999),
        (U(10**6), 10**12),
        (GL(10**6), 10**12),
        (SL(10**6), 999999999999),
        (Sp(10**6), 500000500000),
        (Semidirect(SO(10**6)), 500000500000),
    ],
    ids=str,
)
def test_basis_larger_than_memory_raises(frame, dim):
    assert frame.dim == dim
    assert repr(frame)
    group = frame if isinstance(frame, MatrixGroup) else frame.group
    with pytest.raises(MemoryError, match=r"is too large: the matrices of its .* fields need"):
        group.basis  # noqa: B018


@pytest.mark.parametrize("u", [[np.inf, 0.2, 0.3], [1e200, 0.2, 0.3], [np.nan, 0.2, 0.3]])
def test_overflowing_brackets_do_not_count_as_commuting(u):
    """Beyond a turn there is no derivative of coordinates, unless they commute."""
    with np.errstate(all="ignore"):
        assert np.isnan(SO3().dexpinv(u, [0.1, 0.2, 0.3])).all()
        frame = MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]]])
        assert np.isnan(frame.dexpinv([u[0], 0.2], [0.2, 0.1], order=4)).all()
