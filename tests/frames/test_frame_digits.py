"""Digits of exponentials and logarithms, from the smallest coefficients to the largest.

The references are computed by flint in 120 digits and more.
"""

import numpy as np
import pytest
from exact import doubles, flint_matrix
from flint import ctx
from frame_examples import COMPACT_GROUPS, SMALL_EXPONENTS
from refusals import refuses

from cg import frames as fr

pytestmark = pytest.mark.no_core

UNITARY = [fr.SO3(), fr.SO(6), *COMPACT_GROUPS]
OTHERS = [*(frame for frame in SMALL_EXPONENTS if isinstance(frame, fr.MatrixGroup)), fr.SE3()]
GROUPS = UNITARY + OTHERS
MATRICES = [
    fr.SO(5), fr.SO(8, "space"), fr.SO(12), fr.SU(4), fr.SU(12),
    fr.SO(13), fr.SO(20, "space"), fr.SU(14, "body"), fr.U(13),  # by BLAS
]  # fmt: skip
EPSILON = np.finfo(float).eps
SMALL = [1e-300, 1e-160, 1e-20, 1e-16, 1e-12, 1e-9, 1e-6, 1e-3, 0.03]


def identity(group):
    return flint_matrix(np.eye(group.size, dtype=group.dtype))


def exact_exponential(group, v):
    """The exponential of the algebra's matrix of doubles."""
    return flint_matrix(group.algebra(v)).exp()


def of_size(group, rng, size):
    v = group.random_vector(rng)
    return v * (size / np.linalg.norm(group.algebra(v)))


@pytest.mark.parametrize("group", [*GROUPS, *MATRICES], ids=repr)
@pytest.mark.parametrize("size", [*SMALL, 0.5, 0.86, 1.0, 1.9, 2.1, 10.0, 90.0, 1e3, 1e8])
def test_exponentials(group, size):
    if group in OTHERS and size > 10.0:
        size = 30.0  # they grow exponentially
    rng = np.random.default_rng(61)
    with ctx.workdps(400):
        for _ in range(5 if group.size < 8 else 2):
            v = of_size(group, rng, size)
            exact = exact_exponential(group, v)
            actual = group.exponential(v)
            expected = doubles(exact)
            scale = max(1.0, np.abs(expected).max())
            rounding = 8.0 * EPSILON * (1.0 + size) * scale
            np.testing.assert_allclose(actual, expected, rtol=0, atol=rounding)
            # what is far below one has its own digits beside the diagonal
            away = doubles(exact - identity(group))
            beside = ~np.eye(group.size, dtype=bool)
            error = np.abs(actual - away)[beside].max(initial=0.0)
            if size < 1.0:
                assert error <= 4.0 * EPSILON * size


@pytest.mark.parametrize("group", GROUPS, ids=repr)
@pytest.mark.parametrize("size", [0.2, 0.3, 1.0, 3.0])
def test_logarithms_far_from_the_identity(group, size):
    rng = np.random.default_rng(63)
    with ctx.workdps(120):
        for _ in range(5):
            x = group.exponential(of_size(group, rng, size))
            coordinates = group.logarithm(x)
            back = doubles(exact_exponential(group, coordinates) - flint_matrix(x))
            condition = np.linalg.cond(x)
            assert np.abs(back).max() <= 30.0 * EPSILON * condition * np.abs(x).max()


@pytest.mark.parametrize("size", [1e-15, 1e-12, 1e-9, 1e-5])
def test_coordinates_of_quaternions_and_unit_vectors_nearby(size):
    """To first order they are the difference of the points in the axes of the coefficients."""
    rng = np.random.default_rng(65)
    quaternions = fr.UnitQuaternion(), fr.UnitQuaternion("space", scalar_first=True)
    for frame in (*quaternions, fr.Sphere(2), fr.Sphere(4)):
        y0 = frame.random_point(rng)
        y1 = frame.flow(size * frame.random_vector(rng), y0)
        coordinates = frame.exp_coordinates(y0, y1)
        tangent = (y1 - y0) - y0 * (y0 @ (y1 - y0))
        np.testing.assert_allclose(
            frame.field(coordinates, y0), tangent, rtol=0, atol=size * (1e-15 + 3.0 * size**2)
        )


@pytest.mark.parametrize("size", [1e4, 1e6, 1e9, 1e12, 1e15, 1e50, 1e150])
@pytest.mark.parametrize("frame", [
    *UNITARY, fr.UnitQuaternion(), fr.Sphere(2), fr.Sphere(4), fr.Stiefel(5, 2),
    fr.IsospectralOrbit((-1.0, 0.25, 1.5)),
    fr.IsospectralOrbit((0.0, 0.5, 1.0), hermitian=True),
    fr.CoadjointOrbit(fr.SO3(), (0.6, 0.0, -0.8)), fr.Product(fr.SO(4), fr.U(2)),
], ids=repr)  # fmt: skip
def test_large_angles_stay_on_compact_manifolds(frame, size):
    rng = np.random.default_rng(66)
    y = frame.random_point(rng, (3,))
    v = frame.random_vector(rng, (3,))
    v[0] *= size / np.linalg.norm(v[0])
    moved = frame.flow(v, y)
    assert frame.membership_error(moved).max() < 4e-15
    np.testing.assert_allclose(moved[1], frame.flow(v[1], y[1]), rtol=0, atol=1e-15)
    if size <= 1e9:
        back = frame.flow(-v, moved)
        np.testing.assert_allclose(back, y, rtol=0, atol=5.0 * EPSILON * size)


NOT_COMPACT = [
    *OTHERS[:7], fr.Semidirect(fr.SL(2)), fr.CoadjointOrbit(fr.SL(2), (0.5, 0.25, 0.75)),
    fr.CoadjointOrbit(fr.SU(3), (0.5, -0.25, 1.0, 0.0, 0.75, 0.0, -0.5, 0.25)),
    fr.MatrixFrame([[[0.0, 1.0], [-1.0, 0.0]]]), fr.MatrixFrame([[[0.0, 1j], [1j, 0.0]]], 2),
    fr.Product(fr.SO3(), fr.Sp(2)),
]  # fmt: skip


@pytest.mark.parametrize("frame", NOT_COMPACT, ids=repr)
def test_flows_of_too_large_coefficients_raise(frame):
    rng = np.random.default_rng(68)
    y, v = frame.random_point(rng, (2,)), frame.random_vector(rng, (2,))
    v[1] *= 1e14 / np.linalg.norm(v[1])
    refuses(fr.FlowOverflowError, "v with", frame.flow, v, y)
    with pytest.raises(OverflowError):
        frame.flow(v[1], y)
    v[1] = np.nan
    assert np.isnan(frame.flow(v, y)[1]).any()
