"""Points of products: split without copies, and joined."""

import numpy as np
import pytest

from cg.frames import SO3, SU, Euclidean, Product, Sphere, U, UnitQuaternion

REAL = Product(SO3(), Euclidean(3), Product(Sphere(2), SO3("space")))
COMPLEX = Product(SU(2), Euclidean(1), U(1))
BATCHES = [(), (4,), (2, 3), (0,)]


@pytest.mark.parametrize("batch", BATCHES, ids=repr)
@pytest.mark.parametrize("frame", [REAL, COMPLEX, Product(UnitQuaternion())], ids=repr)
def test_parts_are_views(frame, batch):
    y = frame.random_point(np.random.default_rng(81), batch)
    parts = frame.split(y)
    for factor, part in zip(frame.factors, parts, strict=True):
        assert part.shape == (*batch, *factor.point_shape)
        assert part.dtype == factor.dtype
        assert part.base is not None
        assert y.size == 0 or np.shares_memory(part, y)
    joined = frame.join(*parts)
    np.testing.assert_array_equal(joined, y)
    assert not np.shares_memory(joined, y)


@pytest.mark.parametrize("frame", [REAL, COMPLEX], ids=repr)
def test_parts_of_readonly_points_are_readonly(frame):
    y = frame.random_point(np.random.default_rng(82))
    y.flags.writeable = False
    for part in frame.split(y):
        with pytest.raises(ValueError, match="read-only"):
            part[...] = 0.0
