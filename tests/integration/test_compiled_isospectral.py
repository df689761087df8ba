"""Isospectral orbits in compiled code against the same steps in Python."""

import numpy as np
import pytest
from compiled_differences import compiled_flows
from compiled_examples import ORBITS

from cg.frames import SO3, Euclidean, IsospectralOrbit, Product
from cg.integration.plan.blocks import block_constants, is_compiled
from cg.support.shared_numbers import BlockKind


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


@pytest.mark.parametrize("scale", [0.0, 1e-300, 1e-12, 1e12, 1e300])
def test_units_of_points_make_no_difference(scale):
    unit, scaled = (IsospectralOrbit(tuple(s * np.array([1.0, 2.0, 4.0]))) for s in (1.0, scale))
    rng = np.random.default_rng(3)
    v, y = rng.standard_normal((4, 2, 3)), unit.random_point(rng, 4)
    moved = compiled_flows(scaled)(v, scale * y)
    np.testing.assert_allclose(
        moved, scale * compiled_flows(unit)(v, y), rtol=0, atol=1e-14 * scale
    )
