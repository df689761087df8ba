"""Points of products: split without copies, and joined."""

import pickle

import numpy as np
import pytest
from refusals import refuses

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
def test_split_of_unusual_arrays(frame):
    y = frame.random_point(np.random.default_rng(83), (2, 5))
    expected = frame.split(y)
    wide = np.zeros((2, 5, 2 * y.shape[-1]))
    wide[..., ::2] = y
    bytes_ = np.zeros(y.nbytes + 1, dtype=np.uint8)
    unaligned = bytes_[1:].view(np.float64).reshape(y.shape)
    unaligned[...] = y
    same_type = y.astype(pickle.loads(pickle.dumps(y.dtype)))
    for odd in (wide[..., ::2], np.asfortranarray(y), unaligned, y.tolist(), same_type):
        for part, right in zip(frame.split(odd), expected, strict=True):
            np.testing.assert_array_equal(part, right)
    for part, right in zip(frame.split(wide[1, 2, ::2]), expected, strict=True):
        np.testing.assert_array_equal(part, right[1, 2])
    swapped = y[1, 2].astype(">f8")
    for part, right in zip(frame.split(swapped), expected, strict=True):
        np.testing.assert_array_equal(part, right[1, 2])
    for wrong in (y[0, 0, :-1], 1.0, np.zeros((3, y.shape[-1] + 1))):
        refuses(ValueError, "y must", frame.split, wrong)


@pytest.mark.parametrize("frame", [REAL, COMPLEX], ids=repr)
def test_join_of_unusual_arrays(frame):
    y = frame.random_point(np.random.default_rng(84))
    parts = frame.split(y)
    turned = [np.asfortranarray(part) for part in parts]
    strided = [np.repeat(part, 2, axis=-1)[..., ::2] for part in parts]
    for odd in (turned, strided, [part.tolist() for part in parts]):
        np.testing.assert_array_equal(frame.join(*odd), y)
    many = np.broadcast_to(parts[0], (3, *parts[0].shape))
    np.testing.assert_array_equal(frame.join(many, *parts[1:]), np.broadcast_to(y, (3, y.size)))


@pytest.mark.parametrize("frame", [REAL, COMPLEX], ids=repr)
def test_parts_of_readonly_points_are_readonly(frame):
    y = frame.random_point(np.random.default_rng(82))
    y.flags.writeable = False
    for part in frame.split(y):
        with pytest.raises(ValueError, match="read-only"):
            part[...] = 0.0
