"""Brackets of frames and dexp⁻¹; `test_frame_check.py` compares both with flows."""

import numpy as np
import pytest
from bracket_examples import CLOSED_COORDINATES, WITH, vectors
from frame_examples import FRAMES, HEISENBERG, name
from refusals import refuses

from cg.frames import SO, SO3, SU, FieldFrame, MatrixFrame, Product, Semidirect, Sphere
from cg.frames.algebra import bernoulli_terms, series_dexpinv
from cg.frames.facts import facts_of

pytestmark = pytest.mark.no_core

# Flows of the fields of HEISENBERG don't keep to their span.
OPEN = MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]]])
over_frames = pytest.mark.parametrize("frame", WITH, ids=name)


def test_bracket_raises_for_fields_without_lie_algebra():
    without = [frame for frame in FRAMES if not facts_of(frame).has_brackets]
    assert [type(frame) for frame in without] == [FieldFrame, MatrixFrame]
    assert without[0] is HEISENBERG


@over_frames
def test_bracket_broadcasts(frame):
    u, v = vectors(frame, 1, 2), vectors(frame, 2, 6).reshape(3, 2, -1)
    for order, function in ((0, frame.bracket), (7, frame.dexpinv)):
        options = {"order": order} if order else {}
        actual = function(u, v, **options)
        assert actual.shape == v.shape
        for i, j in np.ndindex(3, 2):
            np.testing.assert_allclose(
                actual[i, j], function(u[j], v[i, j], **options), rtol=0, atol=1e-14
            )


@pytest.mark.parametrize("frame", CLOSED_COORDINATES, ids=name)
@pytest.mark.parametrize("size", [1e-200, 1e-9, 1e-4, 0.1, 0.7, 0.99, 1.01, 2.0])
def test_dexpinv_closed_forms_match_the_series(frame, size):
    rng = np.random.default_rng(3)
    u, v = rng.standard_normal((2, frame.dim))
    u[:3] *= size / np.linalg.norm(u[:3])
    if frame.dim > 6 and isinstance(frame, Product):
        u[6:] *= size / np.linalg.norm(u[6:])
    series = series_dexpinv(lambda w: frame.bracket(u, w), v, 70)
    np.testing.assert_allclose(frame.dexpinv(u, v), series, rtol=0, atol=4e-15 * (1 + size))


@pytest.mark.parametrize("frame", [SO(4), SU(3), Semidirect(SO(2))], ids=name)
def test_dexpinv_series_is_truncated_by_order(frame):
    u, v = vectors(frame, 4, 2)
    powers = [v]
    for _ in range(8):
        powers.append(frame.bracket(u, powers[-1]))
    terms = [float(t) for t in bernoulli_terms(8)]
    for order, last in ((1, 1), (2, 2), (3, 2), (4, 4), (5, 4), (6, 6), (7, 6), (8, 8)):
        expected = sum(terms[k] * powers[k] for k in range(last + 1))
        np.testing.assert_allclose(frame.dexpinv(u, v, order=order), expected, rtol=0, atol=2e-14)


@pytest.mark.parametrize("frame", [Sphere(2), Sphere(4), Product(SO3(), Sphere(1))], ids=name)
def test_without_isotropy_keeps_the_tangent(frame):
    rng = np.random.default_rng(1)
    v, y = rng.standard_normal((5, frame.dim)), frame.random_point(rng, 5)
    short = frame.without_isotropy(v, y)
    np.testing.assert_allclose(frame.field(short, y), frame.field(v, y), rtol=0, atol=1e-14)
    np.testing.assert_allclose(frame.without_isotropy(short, y), short, rtol=0, atol=1e-14)
    assert (np.linalg.norm(short, axis=-1) <= np.linalg.norm(v, axis=-1)).all()


def test_bracket_and_dexpinv_error_messages():
    refuses(NotImplementedError, r"bracket=\.\.\.", HEISENBERG.bracket, [1.0, 0.0], [0.0, 1.0])
    with pytest.raises(NotImplementedError, match="its matrices do not span a Lie algebra"):
        OPEN.bracket([1.0, 0.0], [0.0, 1.0])
    with pytest.raises(NotImplementedError, match="its matrices do not span a Lie algebra"):
        Product(SO3(), OPEN).dexpinv(np.ones(5), np.ones(5))
    refuses(ValueError, "u must", SO3().bracket, [1.0, 0.0], [0.0, 1.0, 0.0])
    refuses(ValueError, "v must", SO3().dexpinv, [1.0, 0.0, 0.0], [0.0, 1.0])
    refuses(ValueError, "order must", SO3().dexpinv, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], order=0)
    with pytest.raises(TypeError, match="bracket must"):
        FieldFrame([lambda y: y], lambda v, y: y, point_shape=1, bracket=3)
