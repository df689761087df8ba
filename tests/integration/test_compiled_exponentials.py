"""Flows by compiled groups: what is not finite, and the spaces on which groups act."""

import numpy as np
import pytest
from frame_examples import name

from cg.frames import SO, SU, IsospectralOrbit, Sphere, Stiefel
from cg.integration.step.flows import Flows, _CompiledFlows, _GroupFlows, dexpinv_of, flows_of


def test_what_is_not_finite_stays_so():
    for frame in (SO(4), SO(7), SU(3), SU(4)):
        for value in (np.nan, np.inf):
            v = np.full((1, frame.dim), value)
            moved = flows_of(frame)(v, np.eye(frame.n, dtype=frame.dtype), restore=False)
            assert not np.isfinite(moved).all()


ACTED_ON = [Sphere(3), Stiefel(5, 2), IsospectralOrbit((1.0, 2.0, 4.0), hermitian=True)]


@pytest.mark.parametrize("frame", ACTED_ON, ids=name)
@pytest.mark.parametrize("lead", [(), (5,), (2, 3)])
def test_spaces_are_moved_by_their_compiled_group(frame, lead):
    flows, dexpinv = flows_of(frame), dexpinv_of(frame, 8)
    assert isinstance(flows, _GroupFlows)
    rng = np.random.default_rng(1)
    v, y = rng.standard_normal((*lead, 3, frame.dim)), frame.random_point(rng, lead)
    for restore in (False, True):
        moved = flows(v, y, restore)
        np.testing.assert_allclose(moved, Flows(frame)(v, y), rtol=0, atol=4e-14)
    assert frame.membership_error(flows(v, y)).max() < 1e-13
    u, w = 0.1 * v[..., 0, :], v[..., 1, :]
    np.testing.assert_allclose(dexpinv(u, w), frame.dexpinv(u, w, order=8), rtol=0, atol=1e-13)


def test_compiled_spaces_are_not_among_them():
    assert isinstance(flows_of(Sphere(2)), _CompiledFlows)
    assert isinstance(flows_of(Sphere(12)), _GroupFlows)
