"""Properties of single frames, and rejected arguments."""

import warnings

import numpy as np
import pytest
from refusals import refuses

from cg import frames as fr

pytestmark = pytest.mark.no_core

GROUPS = [
    fr.SO(4), fr.U(2), fr.SU(2), fr.SU(3), fr.GL(2), fr.SL(3), fr.Sp(4), fr.SE3(),
    fr.Semidirect(fr.SL(2), 2),
]  # fmt: skip


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_bases_span_lie_algebras(group):
    rng = np.random.default_rng(30)
    v = rng.standard_normal((3, group.dim))
    np.testing.assert_allclose(group.vee(group.algebra(v)), v, rtol=0, atol=1e-14)
    u, w = group.algebra(v[0]), group.algebra(v[1])
    bracket = np.einsum("i,j,ijk->k", v[0], v[1], group.structure_constants)
    np.testing.assert_allclose(group.algebra(bracket), u @ w - w @ u, rtol=0, atol=2e-14)
    with pytest.raises(ValueError, match="read-only"):
        group.basis[0] = 0.0


def test_membership_by_known_distances():
    phase = np.exp(0.3j) * np.eye(3)
    assert fr.U(3).membership_error(phase) == pytest.approx(0.0, abs=1e-15)
    assert fr.SU(3).membership_error(phase) == pytest.approx(2 * np.sin(0.15), abs=5e-15)
    assert fr.U(3).membership_error(1.01 * phase) == pytest.approx(0.01, abs=5e-15)
    assert fr.SO(4).membership_error(np.diag([1.0, 1, 1, -1])) == pytest.approx(2.0, abs=1e-14)
    for factor, error in ((1.001, 1e-3), (-1.0, 2.0), (0.0, 1.0)):
        assert fr.SO3().membership_error(factor * np.eye(3)) == pytest.approx(error, abs=5e-15)
    sheared = np.eye(3) + 1e-6 * np.eye(3, k=1)
    assert fr.SO3().membership_error(sheared) == pytest.approx(np.sqrt(0.5) * 1e-6, rel=1e-5)
    assert fr.SL(2).membership_error(np.diag([1.0, 1.02])) == pytest.approx(0.01, abs=5e-15)
    assert fr.Sp(2).membership_error(np.diag([1.0, 1.02])) == pytest.approx(0.01, abs=5e-15)
    assert fr.Stiefel(3, 2).membership_error(1.01 * np.eye(3, 2)) == pytest.approx(0.01, abs=5e-15)
    assert fr.Sphere(3).membership_error([0.0, 0.98, 0.0, 0.0]) == pytest.approx(0.02, abs=5e-15)
    assert fr.GL(2).membership_error(np.ones((2, 2))) == np.inf
    bent = np.eye(4)
    bent[3, 0] = 0.01
    assert fr.SE3().membership_error(bent) == pytest.approx(0.01, abs=5e-15)
    orbit = fr.IsospectralOrbit((1.0, 2.0))
    assert orbit.membership_error(np.diag([2.0, 1.03])) == pytest.approx(0.03, abs=1e-14)
    assert orbit.membership_error([[1.0, 0.01], [-0.01, 2.0]]) == pytest.approx(0.01, abs=1e-14)
    hermitian = fr.IsospectralOrbit.through([[1.0, 1j], [-1j, 2.0]])
    assert (hermitian.hermitian, hermitian.dim) == (True, 3)
    for lowest, error in ((0.5, 0.0), (-0.5, 0.5), (-3.0, 3.0)):
        symmetric = [[lowest + 1.0, 1.0], [1.0, lowest + 1.0]]
        assert fr.SPD(2).membership_error(symmetric) == pytest.approx(max(error, 0.0), abs=1e-15)
    refuses(ValueError, "must be a point of SPD", fr.SPD(2).check_point, [[1.0, 2.0], [2.0, 1.0]])
    zero = fr.CoadjointOrbit(fr.SO3(), (0.0, 0.0, 0.0))
    assert not zero.coefficients(np.zeros((2, 3)), np.zeros((2, 3))).any()
    momentum = fr.CoadjointOrbit(fr.SO3(), (3.0, 0.0, 4.0))
    assert momentum.membership_error([0.0, 5.05, 0.0]) == pytest.approx(0.05, rel=1e-2)
    assert momentum.membership_error([0.0, 0.0, 0.0]) > 1.0


def test_coadjoint_orbits_compute_their_casimirs():
    body = fr.CoadjointOrbit(fr.SO3(), (1.0, 2.0, 3.0))
    assert body.linear_casimirs.shape == (0, 3)
    np.testing.assert_allclose(
        abs(body.quadratic_casimirs), [np.eye(3) / np.sqrt(3)], rtol=0, atol=5e-15
    )
    assert len(fr.CoadjointOrbit(fr.SE3(), (1.0,) * 6).quadratic_casimirs) == 2
    assert len(fr.CoadjointOrbit(fr.SU(3), (1.0,) * 8).quadratic_casimirs) == 1
    m, v = np.random.default_rng(34).standard_normal((2, 3))
    np.testing.assert_allclose(body.field(v, m), np.cross(m, v), rtol=0, atol=1e-15)
    space = fr.CoadjointOrbit(fr.SO3(), (1.0, 2.0, 3.0), "space")
    np.testing.assert_allclose(space.field(v, m), np.cross(v, m), rtol=0, atol=1e-15)


def test_check_point_of_complex_frames():
    point = fr.U(2).check_point(np.eye(2), name="start")
    assert point.dtype == np.complex128
    refuses(ValueError, "start must", fr.U(2).check_point, "phase", name="start")
    with pytest.raises(ValueError, match=r"its distance from the manifold is 0\.765"):
        fr.SU(2).check_point(1j**0.5 * np.eye(2))


ALGEBRAS = [fr.SO3(), fr.SO(2), *GROUPS[:4], fr.SU(2, "body"), *GROUPS[5:], fr.U(1)]


@pytest.mark.parametrize("group", ALGEBRAS, ids=repr)
@pytest.mark.parametrize("size", [1e-200, 1.0, 1e200])
def test_coefficients_reject_matrices_outside_the_algebra(group, size):
    rng = np.random.default_rng(38)
    v = size * rng.standard_normal((2, 3, group.dim))
    inside = group.algebra(v)
    np.testing.assert_allclose(group.vee(inside), v, rtol=0, atol=1e-14 * size)
    rounded = inside * (1.0 + 1e-11 * rng.standard_normal(inside.shape))
    np.testing.assert_allclose(group.vee(rounded), v, rtol=0, atol=1e-9 * size)
    if size < 1.0:
        return
    off = inside.copy()
    off[1, 2] += 1e-6 * size * rng.standard_normal(group.point_shape)
    message = r"matrix must be in the Lie algebra of .*: its distance from it is .*e-0[678] of its"
    refuses(ValueError, message, group.vee, off)
    np.testing.assert_allclose(group.vee(off[0]), v[0], rtol=0, atol=1e-14 * size)


def test_coefficients_accept_rounding_errors():
    """At an equilibrium the tangent is rounding errors only."""
    group = fr.SO(3)
    rounding = 1e-15 * np.random.default_rng(39).standard_normal((3, 3))
    assert np.abs(group.vee(rounding)).max() < 1e-14
    np.testing.assert_array_equal(group.vee(np.zeros((3, 3))), np.zeros(3))
    assert np.isnan(group.vee(np.full((3, 3), np.nan))).all()


def test_coefficients_on_spd_of_eigenvalues_far_apart():
    frame, generator = fr.SPD(2), np.diag([-12.0, 1.0])
    for small in (1e-150, 1e-170, 1e-300):
        y = np.diag([small, 1e13])
        slope = generator @ y + y @ generator.T
        moved = frame.field(frame.coefficients(y, slope), y)
        np.testing.assert_allclose(np.diagonal(moved), np.diagonal(slope), rtol=1e-14)
    for singular in (np.zeros((2, 2)), np.diag([0.0, 1.0]), np.diag([np.inf, 1.0])):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            frame._coefficients_at(singular, np.eye(2))
