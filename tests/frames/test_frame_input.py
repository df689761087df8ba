"""Bad input to frames is rejected by name; unusual valid input is accepted."""

import tracemalloc

import numpy as np
import pytest
from frame_examples import FRAMES, name
from refusals import refuses

from cg import frames as fr
from cg.frames.matrix_group import MatrixGroup

pytestmark = pytest.mark.no_core

TWO = fr.Product(fr.SO3(), fr.SO3())
MASKED = np.ma.masked_array([1.0, 2.0, 3.0], mask=[1, 0, 0])


def test_accepts_unusual_array_types():
    frame, v = fr.SO3(), [0.5, -0.25, 1.0]
    y = frame.flow([1.0, 2.0, 3.0], np.eye(3))
    expected = frame.flow(v, y)
    readonly = y.copy()
    readonly.flags.writeable = False
    wide = np.zeros((6, 6))
    wide[::2, ::2] = y
    for odd in (readonly, wide[::2, ::2], np.asfortranarray(y), y.tolist(), y.astype(object)):
        assert np.abs(frame.flow(v, odd) - expected).max() < 1e-16  # zero but with NumPy 2.0
    np.testing.assert_array_equal(frame.flow(np.ma.masked_array(v), y), expected)
    np.testing.assert_array_equal(frame.flow(np.float32(v), y), expected)
    np.testing.assert_array_equal(frame.flow([1, 2, 3], np.eye(3, dtype=int)), y)
    assert frame.flow(np.zeros((0, 3)), y).shape == (0, 3, 3)


class DependentBasis(MatrixGroup):
    dim, size, convention = 2, 2, "body"

    def _make_basis(self):
        return np.array([[[0, -1.0], [1, 0]], [[0, -2.0], [2, 0]]])

    def membership_error(self, y):
        return np.zeros(np.shape(y)[:-2])

    def random_point(self, rng, size=()):
        return np.broadcast_to(np.eye(2), (*np.atleast_1d(size), 2, 2))


def test_dependent_generators_are_refused():
    message = "basis must have 2 linearly independent matrices, got 1"
    refuses(ValueError, message, fr.check, DependentBasis())


def field_frame(**changes):
    given = {"fields": [lambda y: y], "flow": lambda v, y: np.exp(v[0]) * y, "point_shape": 1}
    return fr.FieldFrame(**given | changes)


@pytest.mark.parametrize(("make", "error", "message"), [
    (lambda: fr.SO(1), ValueError, "n must be at least 2, got 1"),
    (lambda: fr.SO(3, "left"), ValueError, "convention must be"),
    (lambda: fr.UnitQuaternion(scalar_first=1), TypeError, "scalar_first must be True or"),
    (lambda: fr.Sp(3), ValueError, "n must be even, got 3"),
    (lambda: fr.SU(1), ValueError, "n must be at least 2"),
    (lambda: fr.Stiefel(2, 3), ValueError, "k must be at most 2, got 3"),
    (lambda: fr.Semidirect(fr.SO3), TypeError, "group must be a MatrixGroup"),
    (lambda: fr.Semidirect(fr.SU(2)), ValueError, "group must be real"),
    (lambda: fr.IsospectralOrbit((1.0,)), ValueError, "spectrum must be at least two"),
    (lambda: fr.IsospectralOrbit((1, 2), hermitian=2), TypeError, "hermitian must be True or"),
    (lambda: fr.CoadjointOrbit(fr.SO3(), (1.0, 2.0)), ValueError, "point must be 3 finite"),
    (lambda: fr.CoadjointOrbit(np.eye(3), (1.0,)), TypeError, "algebra must be a MatrixGroup"),
    (lambda: fr.MatrixFrame(np.eye(2)), ValueError, r"matrices must have shape \(m, n, n\)"),
    (lambda: fr.MatrixFrame([[[np.inf]]]), ValueError, "matrices must be finite"),
    (lambda: fr.MatrixFrame([[[1.0]]], restore=1), TypeError, "restore must be a function or"),
    (lambda: fr.FieldFrame([1], abs, point_shape=1), TypeError, r"fields\[0\] must be a function"),
    (lambda: fr.FieldFrame([abs], 1, point_shape=1), TypeError, "flow must be a function"),
    (lambda: fr.FieldFrame([abs], abs, point_shape=0), ValueError, "point_shape must be"),
    (lambda: fr.FieldFrame([abs], abs, point_shape=1, dtype=int), ValueError, "dtype must be"),
    (lambda: fr.Euclidean(0), ValueError, "n must be at least 1, got 0"),
    (fr.Product, ValueError, "at least one frame"),
    (lambda: fr.Product(fr.SO3(), fr.SO3), TypeError, r"factors\[1\] must be a Frame"),
    (lambda: field_frame(fields=abs), TypeError, "fields must be a sequence of functions"),
    *(
        (lambda n=n: field_frame(point_shape=n), TypeError, "point_shape must be an integer")
        for n in (None, 1.0, np.nan)
    ),
    (lambda: fr.UnitQuaternion(np.array(["body"])), TypeError, "convention must be .* got array"),
    (lambda: fr.CoadjointOrbit(fr.SO3(), MASKED), ValueError, "point must be an array of real"),
    (lambda: TWO.join(np.eye(3)), ValueError, "parts must be 2 points, got"),
    (lambda: TWO.join(np.eye(3), [1, 2]), ValueError, "must have shape"),
    (lambda: TWO.join(np.zeros((2, 3, 3)), np.zeros((3, 3, 3))), ValueError,
     r"parts must have leading axes that broadcast, got \[\(2,\), \(3,\)\]"),
    *(
        (lambda m=m: fr.IsospectralOrbit.through(m), ValueError, "y0 must be symmetric, or Herm")
        for m in ([[1.0, 2.0], [3.0, 4.0]], [[1.0, 1j], [1j, 1.0]], [[1e9, 1e3], [0, 1e9]])
    ),
    (lambda: fr.IsospectralOrbit.through(np.ones((2, 3))), ValueError, "finite square matrix"),
    (lambda: fr.LinearAction([]), ValueError, "at least one matrix"),
    (lambda: fr.LinearAction([np.ones((2, 3))]), ValueError, r"\[0\] must be a square matrix, got"),
    (lambda: fr.LinearAction([[[1j * np.inf]]]), ValueError, r"generators\[0\] must .*, got .*inf"),
    (lambda: fr.LinearAction([np.eye(2), np.eye(3)]), ValueError, "one shape"),
    (lambda: fr.LinearAction(7), TypeError, "must be a sequence of matrices"),
])  # fmt: skip
def test_constructors_reject_bad_arguments(make, error, message):
    refuses(error, message, make)


@pytest.mark.parametrize("method", ["random_point", "random_vector"])
@pytest.mark.parametrize("frame", FRAMES, ids=name)
def test_random_points_and_vectors(frame, method):
    draw = getattr(frame, method)
    rng = np.random.default_rng
    for wrong in (0, None, "seed", np.random, np.random.RandomState(0)):
        refuses(TypeError, r"rng must be a generator such as .*, got", draw, wrong)
    for size in (1.5, "2", None, (2, 1.5), True, (True,), {2}, [[2]]):
        refuses(TypeError, "size must", draw, rng(0), size)
    for size in (-1, (2, -1)):
        refuses(ValueError, "size must", draw, rng(0), size)
    expected = draw(rng(0), (3,))
    for size in (3, [3], np.int64(3), (np.int64(3),)):
        np.testing.assert_array_equal(draw(rng(0), size), expected)
    assert len(draw(rng(0), 0)) == 0


@pytest.mark.parametrize(("frame", "dim"), [
    (fr.SO(10**6), 499999500000), (fr.Sphere(10**6), 500000500000),
    (fr.Stiefel(10**6, 2), 499999500000), (fr.SU(10**6), 999999999999), (fr.U(10**6), 10**12),
    (fr.GL(10**6), 10**12), (fr.SL(10**6), 999999999999), (fr.Sp(10**6), 500000500000),
    (fr.Semidirect(fr.SO(10**6)), 500000500000),
], ids=str)  # fmt: skip
def test_basis_larger_than_memory_raises(frame, dim):
    assert frame.dim == dim
    assert repr(frame)
    group = frame if isinstance(frame, MatrixGroup) else frame.group
    with pytest.raises(MemoryError):
        group.basis  # noqa: B018


@pytest.mark.parametrize(
    "kind", [fr.SO, fr.U, fr.SU, fr.GL, fr.SL, fr.Sp, lambda n: fr.Semidirect(fr.SO(n), 2)]
)
def test_coefficients_of_large_matrices_need_no_basis(kind, monkeypatch):
    """They are those that the matrices of the fields give, and take memory for a few matrices."""
    rng = np.random.default_rng(26)
    for n in (2, 4, 6):
        frame = kind(n)
        v = rng.standard_normal((3, frame.dim))
        matrix = frame.algebra(v) + rng.standard_normal((3, *frame.point_shape))
        projected = frame._algebra_projection(matrix)
        with monkeypatch.context() as patch:
            patch.setattr("cg.frames.matrix_group.MAX_DENSE", 0)
            again = frame.algebra(v)
            found = frame._algebra_projection(matrix)
        np.testing.assert_allclose(again, np.tensordot(v, frame.basis, 1), rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(found, projected, rtol=0.0, atol=1e-14)
    frame = kind(80)
    v = rng.standard_normal(frame.dim)
    tracemalloc.start()
    matrix = frame.algebra(v)
    found = frame.vee(matrix)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100 * matrix.nbytes  # the matrices of the fields take 3200 times as much or more
    np.testing.assert_allclose(found, v, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("frame", "y", "projects"), [
    (fr.SO3(), 2.0 * np.eye(3), True),
    (fr.UnitQuaternion(), [2.0, 0.0, 0.0, 0.0], True),
    (fr.SO3(), np.diag([1.0, 1.0, -1.0]), False),  # several rotations are as near
    (fr.SO(4), np.diag([1.0, 1.0, 1.0, -1.0]), False),
    (fr.SE3(), np.diag([1.0, 1.0, -1.0, 1.0]), False),
    (fr.UnitQuaternion(), np.zeros(4), False),
    (fr.UnitQuaternion(), [7e6, 0.0, 0.0, 0.0], False),  # a position
])  # fmt: skip
def test_projection_is_advised_where_there_is_one(frame, y, projects):
    with pytest.raises(ValueError, match="y0 must be a point of") as error:
        frame.check_point(y, name="y0")
    assert str(error.value).endswith("; frame.project(y0) is the nearest point") == projects


@pytest.mark.parametrize(
    "frame",
    [fr.SE3(), fr.Semidirect(fr.SO3(), 2), fr.Semidirect(fr.SO(4), 1), fr.Semidirect(fr.GL(2), 1)],
    ids=repr,
)
def test_no_points_have_no_coordinates(frame):
    y = frame.random_point(np.random.default_rng(0), 0)
    for function in (frame.coefficients, frame.exp_coordinates, frame.difference):
        assert function(y, y).shape == (0, frame.dim)
    refuses(ValueError, "with n > 0", frame.mean, y)
