"""Coordinates at and near branch cuts of logarithms."""

import warnings

import numpy as np
import pytest
from compiled_examples import difference_of
from slow_cases import cases

from cg.frames import GL, SL, SU, Semidirect, Sp, Sphere, U


def off(frame, v, y0, y1):
    return np.abs(frame.flow(v, y0) - y1).max()


def shortest_length(angles):
    """Return the smallest norm of angles, modulo whole turns, that add up to zero, for SU(n)."""
    angles = angles - 2 * np.pi * np.round(angles / (2 * np.pi))
    turns = round(angles.sum() / (2 * np.pi))
    # 2 |Omega| in the Frobenius norm is that of the coefficients times the root of two.
    moved = np.sort(np.copysign(1.0, turns) * angles)[::-1].copy()
    moved[: abs(turns)] -= 2 * np.pi
    return np.sqrt(2.0 * (moved**2).sum())


@pytest.mark.parametrize(
    ("n", "turns", "convention"),
    cases(
        [3, 12, 13, 25, 26, 27, 33, 40], [1, -1, 2, 5, -12], ["body", "space"],
        quick=lambda n, turns, convention: n < 13 or (n < 33 and turns == 1),
    ),
)  # fmt: skip
def test_angles_of_special_unitary_matrices_add_up_to_zero(n, turns, convention):
    frame, rng = SU(n, convention), np.random.default_rng(211)
    angles = rng.normal(scale=0.02, size=n)
    angles += 2 * np.pi * turns / n - angles.mean()
    vectors = U(n).random_point(rng)
    y0 = frame.random_point(rng)
    for x in (np.diag(np.exp(1j * angles)), (vectors * np.exp(1j * angles)) @ vectors.conj().T):
        y1 = y0 @ x if convention == "body" else x @ y0
        v = frame.exp_coordinates(y0, y1)
        assert off(frame, v, y0, y1) < 1e-13
        np.testing.assert_allclose(np.linalg.norm(v), shortest_length(angles), rtol=1e-13)
    y = np.exp(2j * np.pi * turns / n) * np.eye(n)
    assert off(frame, frame.exp_coordinates(np.eye(n), y), np.eye(n), y) < 1e-13


@pytest.mark.parametrize(
    "frame", [GL(2), GL(3, "body"), GL(6), SL(2), SL(3), Sp(2), Sp(4), Semidirect(SL(2))], ids=repr
)
def test_logarithms_reach_the_point_or_are_nan(frame):
    """This holds for ill-conditioned points too, without warnings of SciPy."""
    rng = np.random.default_rng(213)
    known = 0
    for scale in (0.5, 2.0, 5.0, 10.0, 20.0):
        v = scale * frame.random_vector(rng, (20,))
        y0 = frame.flow(0.5 * scale * frame.random_vector(rng, (20,)), np.eye(frame.size))
        y1 = frame.flow(v, y0)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            coordinates = frame.exp_coordinates(y0, y1)
        has = np.isfinite(coordinates).all(axis=-1)
        assert np.isnan(coordinates[~has]).all()
        errors = np.linalg.norm(frame.flow(coordinates[has], y0[has]) - y1[has], axis=(-2, -1))
        assert (errors <= 1e-8 * np.linalg.norm(y1[has], axis=(-2, -1))).all()
        known += has.sum()
    assert known > 20


def test_coordinates_of_motions_without_a_real_logarithm():
    """All are NaN, those of the translation too."""
    frame = Semidirect(GL(2), 2)
    y = np.eye(4)
    y[:2] = [[-1.0, 0.0, 1.0, 2.0], [0.0, 2.0, 3.0, 4.0]]
    coordinates = frame.exp_coordinates(np.eye(4), np.stack([y, frame.exponential(np.ones(8))]))
    assert np.isnan(coordinates[0]).all()
    np.testing.assert_allclose(coordinates[1], np.ones(8), rtol=1e-14)
    assert np.isnan(frame.logarithm(y)).all()


def test_scipy_prints_nothing(capfd):
    y = np.array([[1.0, 1e9], [0.0, 1.0 + 1e-6]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for frame in (GL(2), GL(2, "body")):
            coordinates = frame.exp_coordinates(np.eye(2), y)
            assert np.isnan(coordinates).all() or off(frame, coordinates, np.eye(2), y) < 10.0
            assert np.isnan(frame.exp_coordinates(np.eye(2), -np.eye(2))).all()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("n", [1, 2, 4])
def test_nearly_antipodal_points_of_spheres(n):
    frame, rng = Sphere(n), np.random.default_rng(214)
    difference, known = difference_of(frame), 0
    for distance in (0.0, 1e-16, 1e-15, 1e-12, -1e-9, 1e-6, -1e-3):
        for _ in range(40):
            y0, v = frame.random_point(rng), frame.random_vector(rng)
            v = frame.without_isotropy(v, y0)
            y1 = frame.flow((np.pi + distance) / np.linalg.norm(v) * v, y0)
            for actual in (frame.exp_coordinates(y0, y1), difference(y0, y1)):
                if np.isfinite(actual).all():
                    assert off(frame, actual, y0, y1) < 4e-15
                    known += 1
    assert known > 500
    assert np.isnan(difference(y0, -y0)).all()
    assert np.isnan(frame.exp_coordinates(y0, -y0)).all()
