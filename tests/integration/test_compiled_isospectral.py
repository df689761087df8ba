"""Isospectral orbits in compiled code against the same steps in Python."""

from functools import partial

import numpy as np
import pytest
from compiled_differences import compiled_flows
from compiled_examples import ORBITS, frames_in_python
from frame_examples import generic

import cg
from cg.frames import SO3, Euclidean, IsospectralOrbit, Product
from cg.integration.plan.blocks import block_constants, is_compiled
from cg.support.shared_numbers import BlockKind


def in_python(call):
    with frames_in_python(dexpinv_of=lambda frame, order: partial(frame.dexpinv, order=order)):
        return call()


def test_which_are_compiled():
    orbit = IsospectralOrbit((4.0, 1.0, 2.0))
    assert orbit.compiled_blocks() == ((BlockKind.ISOSPECTRAL, 3, 0, 1.0, 2.0, 4.0),)
    assert block_constants(Product(orbit, orbit)).tolist() == [1.0, 2.0, 4.0, 1.0, 2.0, 4.0, 0.0]
    assert all(is_compiled(frame) for frame in ORBITS)
    # errors of rotations are angles, those of these matrices are differences of entries
    assert not is_compiled(Product(orbit, SO3()))
    assert not is_compiled(Product(Euclidean(1), Product(orbit)))
    assert not is_compiled(IsospectralOrbit((1.0, 2.0), hermitian=True))
    assert not is_compiled(type("Child", (IsospectralOrbit,), {})((1.0, 2.0)))


@pytest.mark.parametrize("size", [1e-200, 1e-9, 0.5, 90.0, 1e6])
def test_sizes_of_flows(size):
    frame = ORBITS[2]
    rng = np.random.default_rng(2)
    v, y = frame.random_vector(rng, (20, 1)), frame.random_point(rng, 20)
    v *= size / np.linalg.norm(v, axis=-1, keepdims=True)
    moved = compiled_flows(frame)(v, y)
    expected = frame.flow(v[:, 0], y)
    np.testing.assert_allclose(moved, expected, rtol=0, atol=2e-14 * (1 + size))
    assert frame.relative_error(moved).max() < 2e-15


@pytest.mark.parametrize("scale", [0.0, 1e-300, 1e-12, 1e12, 1e300])
def test_units_of_points_make_no_difference(scale):
    unit, scaled = (IsospectralOrbit(tuple(s * np.array([1.0, 2.0, 4.0]))) for s in (1.0, scale))
    rng = np.random.default_rng(3)
    v, y = rng.standard_normal((4, 2, 3)), unit.random_point(rng, 4)
    moved = compiled_flows(scaled)(v, scale * y)
    np.testing.assert_allclose(
        moved, scale * compiled_flows(unit)(v, y), rtol=0, atol=1e-14 * scale
    )


def test_rounding_is_removed_and_eigenvalues_are_given():
    frame = ORBITS[3]
    rng = np.random.default_rng(4)
    y = frame.random_point(rng, 50)
    off = 1e-9 * rng.standard_normal(y.shape)
    moved = compiled_flows(frame)(np.zeros((50, 1, frame.dim)), y + off + off.swapaxes(-2, -1))
    assert frame.relative_error(moved).max() < 2e-15
    np.testing.assert_allclose(moved, y, rtol=0, atol=2e-8)


def test_what_is_not_finite_stays_so():
    frame = ORBITS[2]
    y = frame.random_point(np.random.default_rng(5))
    for value in (np.nan, np.inf):
        moved = compiled_flows(frame)(np.full((1, frame.dim), value), y)
        assert not np.isfinite(moved).any()
        # as of the loop in Python, entries that no flow mixes are left
        still = compiled_flows(frame)(np.zeros((1, frame.dim)), np.where(y == y[0, 0], value, y))
        assert not np.isfinite(still).all()


def test_tolerances_of_entries():
    frame = ORBITS[2]
    f, y0 = generic(frame)
    atol = 10.0 ** -np.random.default_rng(8).integers(4, 8, (4, 4))
    for key in ("DP5(4)", "CF4(3)", "DOP853"):
        options = {"frame": frame, "method": key, "rtol": 1e-13, "atol": atol}

        solve = lambda options=options: cg.solve_ivp(f, (0, 1), y0, **options)
        fast, slow = solve(), in_python(solve)
        assert (fast.steps, fast.nfev) == (slow.steps, slow.nfev)
        np.testing.assert_allclose(fast.t[1], slow.t[1], rtol=1e-9)  # chosen from the slopes
        np.testing.assert_allclose(fast.t, slow.t, rtol=1e-3)
