"""Compiled groups: what is not finite, and the spaces on which they act."""

import numpy as np
import pytest
from compiled_differences import compiled_flows
from frame_examples import name

from cg.frames import SO, SU, IsospectralOrbit, Sphere, Stiefel
from cg.integration.plan.blocks import dexpinv_of, is_compiled


def test_what_is_not_finite_stays_so():
    for frame in (SO(4), SO(7), SU(3), SU(4)):
        for value in (np.nan, np.inf):
            v = np.full((1, frame.dim), value)
            moved = compiled_flows(frame)(v, np.eye(frame.n, dtype=frame.dtype), restore=False)
            assert not np.isfinite(moved).all()


ACTED_ON = [Sphere(3), Stiefel(5, 2), IsospectralOrbit((1.0, 2.0, 4.0), hermitian=True)]


@pytest.mark.parametrize("frame", ACTED_ON, ids=name)
@pytest.mark.parametrize("lead", [(), (5,), (2, 3)])
def test_dexpinv_of_a_space_is_that_of_its_compiled_group(frame, lead):
    assert not is_compiled(frame)
    assert is_compiled(frame.group)
    rng = np.random.default_rng(1)
    u, v = 0.1 * rng.standard_normal((2, *lead, frame.dim))
    expected = frame.dexpinv(u, v, order=8)
    np.testing.assert_allclose(dexpinv_of(frame, 8)(u, v), expected, rtol=0, atol=1e-13)
