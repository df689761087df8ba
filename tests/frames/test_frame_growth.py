"""Solutions that grow on manifolds that aren't compact: rounding stays as small as they are large.

Flows with exponentials in 100 digits are the reference.
"""

import numpy as np
import pytest
from exact import doubles, flint_matrix
from flint import arb_mat, ctx
from refusals import refuses

from cg.frames import GL, SE3, SL, CoadjointOrbit, MatrixFrame, Semidirect, Sp

GROUPS = [
    GL(2), GL(3, "body"), SL(2), SL(2, "body"), SL(3), SL(4), SL(3, "body"), Sp(2), Sp(4),
    Sp(4, "body"), Sp(6), Semidirect(SL(2)), Semidirect(Sp(4, "body"), 2),
]  # fmt: skip
SPACES = [
    CoadjointOrbit(SL(2), (0.5, 0.25, 0.75)),
    CoadjointOrbit(SL(2), (0.5, 0.25, 0.75), "space"),
    CoadjointOrbit(SL(3), (0.5, 0.25, 0.75, -0.5, 0.1, 0.3, 1.0, -0.2)),
    CoadjointOrbit(Sp(4), tuple(np.linspace(-1.0, 1.0, 10))),
    CoadjointOrbit(SE3(), (0.5, 0.25, -0.5, 0.3, 0.2, 0.1)),
    MatrixFrame([[[0.0, 1j], [1j, 0.0]], [[0.5, 0.0], [0.0, -1j]]], 2),
]


def generator(frame, v):
    """The matrix of the flow, which acts from the left or the right."""
    if isinstance(frame, CoadjointOrbit):
        return np.einsum("i,ijk->jk", v, frame._fields)
    if isinstance(frame, MatrixFrame):
        return np.einsum("i,ijk->jk", v, frame.matrices)
    return frame.algebra(v)


def exact_flows(frame, vectors, y0):
    """Return the point after successive flows, as an array of doubles."""
    right = isinstance(frame, GL | SL | Sp | Semidirect) and frame.convention == "body"
    with ctx.workdps(100):
        y = flint_matrix(y0.reshape(len(y0), -1))
        known = {}
        for v in vectors:
            key = v.tobytes()
            if key not in known:
                known[key] = flint_matrix(generator(frame, v)).exp()
            y = y * known[key] if right else known[key] * y
        return doubles(y).reshape(y0.shape)


def hyperbolic(frame, rng, rate):
    """Return coefficients whose matrix has an eigenvalue with that real part, and general ones."""
    while True:
        v = frame.random_vector(rng)
        actual = np.linalg.eigvals(generator(frame, v)).real.max()
        if actual > 0.3:
            return v * (rate / actual)
        if isinstance(frame, CoadjointOrbit) and frame.algebra == SE3():
            return 5.0 * rate * v  # grows like the square of time, at most


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["forward", "backward"])
@pytest.mark.parametrize("frame", GROUPS + SPACES, ids=repr)
def test_growing_solutions_keep_their_digits(frame, way):
    rng = np.random.default_rng(51)
    for _ in range(3):
        v = way * hyperbolic(frame, rng, 0.1)
        vectors = np.tile(v, (200, 1))
        y0 = y = frame.random_point(rng)
        for u in vectors:
            y = frame.flow(u, y)
        expected = exact_flows(frame, vectors, y0)
        size = np.abs(expected).max()
        assert size > (10.0 if "SE3" in repr(frame) else 1e7) or way < 0.0
        np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize("frame", [SL(2), SL(3), Sp(2), Sp(4), Semidirect(SL(2))], ids=repr)
@pytest.mark.parametrize("growth", [1.0, 1e4, 1e8, 1e12, 1e100])
def test_restoring_never_increases_the_error(frame, growth):
    """A point that is accurate to rounding stays so, also if it is large."""
    rng = np.random.default_rng(53)
    n = frame.size - (frame.copies if isinstance(frame, Semidirect) else 0)
    for _ in range(20):
        first, second = SL(2).random_point(rng, (2,)) if n == 2 else frame.random_point(rng, (2,))
        stretch = np.eye(n)
        stretch[0, 0], stretch[n // 2, n // 2] = growth, 1.0 / growth
        with ctx.workdps(300):
            product = arb_mat(first.tolist()) * arb_mat(stretch.tolist()) * arb_mat(second.tolist())
            y = np.array(product.tolist(), dtype=float)
        if isinstance(frame, Semidirect):
            y = frame._assemble(y, np.ones((n, frame.copies)))
        size = np.abs(y).max()
        np.testing.assert_allclose(frame.restore(y), y, rtol=0, atol=2e-14 * size)


def test_large_points_off_the_group_are_rejected():
    large = np.diag([1e6, 1e-6])
    SL(2).check_point(large)
    Sp(2).check_point(large)
    wrong = large @ [[1.0, 1e-3], [1e-3, 1.0]]
    for frame in (SL(2), Sp(2)):
        off = wrong + np.diag([0.0, 0.1])
        refuses(ValueError, r"its relative distance from the manifold is", frame.check_point, off)
    with pytest.raises(ValueError, match=r"its relative distance from the manifold is"):
        Semidirect(SL(2)).check_point(np.diag([1.0, 1.0 + 1e-6, 1.0]))
