"""Coordinates beyond the radius of dexp⁻¹ are rejected."""

from functools import partial

import numpy as np
import pytest
from bracket_examples import CLOSED, CLOSED_FORMS, HEISENBERG_GROUP, vectors
from frame_examples import generic, name
from python_steps import uncompiled

import cg
from cg.frames import (
    SE3,
    SL,
    SO,
    SO3,
    SU,
    Euclidean,
    IsospectralOrbit,
    Power,
    Product,
    Semidirect,
    Sphere,
    Stiefel,
    U,
    UnitQuaternion,
)
from cg.integration.plan.blocks import dexpinv_of, is_compiled

TURN = 2 * np.pi
WITH_SERIES = [
    SO(4), SO(5, "space"), SU(3), SU(4, "body"), U(2), SL(3), Sphere(3), Stiefel(4, 2),
    IsospectralOrbit((1.0, 2.0, 4.0, 7.0)), Semidirect(SO(4)), CLOSED, Power(SU(3), 2), SO(8),
]  # fmt: skip
ALL = [frame for frame in CLOSED_FORMS if not isinstance(frame, Euclidean)] + WITH_SERIES


def sized(frame, radius, seed=3):
    """Return coefficients whose brackets have a given spectral radius, and general ones."""
    u, v = vectors(frame, seed, 2)
    adjoint = frame.bracket(u, np.eye(frame.dim))
    return u * (radius / np.abs(np.linalg.eigvals(adjoint)).max()), v


def functions(frame):
    in_python = partial(frame.dexpinv, order=8)
    return [in_python, dexpinv_of(frame, 8)] if is_compiled(frame) else [in_python]


@pytest.mark.parametrize("frame", ALL, ids=name)
def test_beyond_it_there_is_no_derivative(frame):
    for radius in (1.3 * TURN, 3.5 * TURN):
        u, v = sized(frame, radius)
        for dexpinv in functions(frame):
            assert np.isnan(dexpinv(u, v)).any()
            members = dexpinv(np.stack([u, 0.1 * u]), np.stack([v, v]))
            assert np.isnan(members[0]).any()
            assert np.isfinite(members[1]).all()


@pytest.mark.parametrize("frame", ALL, ids=name)
def test_within_it_there_is(frame):
    u, v = sized(frame, 0.98 * TURN)
    first, *others = (dexpinv(u, v) for dexpinv in functions(frame))
    assert np.isfinite(first).all()
    for other in others:
        np.testing.assert_allclose(other, first, rtol=0, atol=2e-14 * np.abs(first).max())


@pytest.mark.parametrize("frame", ALL, ids=name)
def test_commuting_coefficients_are_unchanged(frame):
    u, _ = sized(frame, 3.5 * TURN)
    for dexpinv in functions(frame):
        np.testing.assert_allclose(dexpinv(u, -2.0 * u), -2.0 * u, rtol=1e-14, atol=1e-14)


def test_a_nilpotent_algebra_has_no_radius():
    u, v = 1e3 * vectors(HEISENBERG_GROUP, 1, 2)
    expected = v - HEISENBERG_GROUP.bracket(u, v) / 2
    np.testing.assert_allclose(HEISENBERG_GROUP.dexpinv(u, v), expected, rtol=1e-14)


FAST = 40.0
STEPPED = [
    SO3(), SE3("space"), UnitQuaternion(), SU(2), Sphere(2), SO(4), SU(3),
    Product(Euclidean(2), SO3("space")), SL(3), Sphere(3), Stiefel(4, 2), CLOSED,
]  # fmt: skip


def fast(frame):
    f, y0 = generic(frame)
    return (lambda t, y: FAST * f(t, y)), y0


@pytest.mark.parametrize("key", ["RKMK4", "RKMK8(5,3)"])
@pytest.mark.parametrize("frame", STEPPED, ids=name)
def test_an_equal_step_that_is_too_long_is_named(frame, key):
    f, y0 = fast(frame)
    message = r"step from t = 0.5 .*too long.*smaller h"

    late = lambda t, y: f(t, y) if t > 0.5 else 0.001 * f(t, y)
    for same in (frame, uncompiled(frame)):
        with pytest.raises(cg.StepTooLongError, match=message):
            cg.integrate(late, (0, 4), y0, frame=same, method=key, h=0.5)


@pytest.mark.parametrize("frame", STEPPED, ids=name)
def test_a_chosen_step_that_is_too_long_is_rejected(frame):
    f, y0 = fast(frame)
    # tolerances that anything meets
    options = {"method": "RKMK5(4)", "rtol": 0.5, "atol": 1e6, "first_step": 0.25}
    actual, again = (
        cg.solve_ivp(f, (0, 0.25), y0, frame=same, **options) for same in (frame, uncompiled(frame))
    )
    assert actual.success
    assert actual.nrejected >= 1
    assert actual.steps >= 2
    assert frame.membership_error(actual.y).max() < 1e-9
    assert (actual.steps, actual.nrejected, actual.nfev) == (
        again.steps,
        again.nrejected,
        again.nfev,
    )
