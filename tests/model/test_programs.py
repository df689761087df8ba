"""Random programs of calls against the model; see `docs/integration.md`."""

import numpy as np
import pytest

import cg
from tests.model.__main__ import run
from tests.model.spaces import SPACES

COUNT, PARTS = 400, 16


@pytest.mark.parametrize("seed", range(PARTS))
def test_programs(seed):
    outcomes = run(COUNT // PARTS, seed, shrink=False)
    assert outcomes["compared"] > 0.7 * COUNT // PARTS


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1200))
def test_many_programs(seed):
    run(250, seed)


@pytest.mark.parametrize("space", SPACES, ids=lambda space: space.expression[10:40])
def test_fields_of_the_model_are_those_of_the_frames(space):
    names = {"cg": cg, "np": np}
    exec(space.prelude, names)
    frame = eval(space.expression, names)
    y = space.start(3)
    assert np.shape(y) == frame.point_shape
    assert frame.membership_error(y) < 1e-12
    if not space.phase and space.returned == (-1,):
        v = np.random.default_rng(1).standard_normal(space.dim)
        np.testing.assert_allclose(space.field(v, y), frame.field(v, y), atol=1e-14)
