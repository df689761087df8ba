"""Frames for the tests of axioms: one of every kind, with its particulars."""

import numpy as np

from cg import frames as fr

# y0' = v0, y1' = v1, y2' = y0 v1 - y1 v0: the Heisenberg group acts on space.
HEISENBERG = fr.FieldFrame(
    [lambda y: np.array([1.0, 0.0, -y[1]]), lambda y: np.array([0.0, 1.0, y[0]])],
    lambda v, y: y + np.array([v[0], v[1], y[0] * v[1] - y[1] * v[0]]),
    point_shape=3,
)

# A phase on the unit circle of the complex plane.
CIRCLE = fr.FieldFrame(
    [lambda z: 1j * z], lambda v, z: z * np.exp(1j * v[0]), point_shape=(1,), dtype=complex,
    membership_error=lambda z: abs(abs(z[0]) - 1.0),
    restore=lambda z: z * (1.5 - 0.5 * abs(z) ** 2), project=lambda z: z / abs(z),
    exp_coordinates=lambda x, z: [np.angle(z[0] * x[0].conj())],
    random_point=lambda rng: np.exp([2j * np.pi * rng.random()]),
)  # fmt: skip

# The ellipse 4 x^2 + y^2 = 4, traversed with a period of pi.
ELLIPSE = fr.MatrixFrame(
    [[[0.0, -1.0], [4.0, 0.0]]],
    membership_error=lambda y: abs(np.sqrt(y[0] ** 2 + y[1] ** 2 / 4.0) - 1.0),
    restore=lambda y: y / np.sqrt(y[0] ** 2 + y[1] ** 2 / 4.0),
    project=lambda y: y / np.sqrt(y[0] ** 2 + y[1] ** 2 / 4.0),
    random_point=lambda rng: np.array([1.0, 2.0]) * fr.Sphere(1).random_point(rng),
)

ROTATIONS = [fr.SO3(), fr.SO3("space")]
QUATERNIONS = [
    fr.UnitQuaternion(), fr.UnitQuaternion("space"), fr.UnitQuaternion(scalar_first=True),
    fr.UnitQuaternion("space", scalar_first=True),
]  # fmt: skip
POSES = [fr.SE3(), fr.SE3("space")]
COMPACT_GROUPS = [
    fr.SO(2), fr.SO(3, "space"), fr.SO(4), fr.SO(5, "space"), fr.U(1), fr.U(2, "body"), fr.U(3),
    fr.SU(2), fr.SU(2, "body"), fr.SU(3), fr.SU(4, "body"),
]  # fmt: skip
COMPACT_SPACES = [
    fr.Sphere(1), fr.Sphere(2), fr.Sphere(4), fr.Stiefel(4, 2), fr.Stiefel(3, 3),
    fr.Grassmann(3, 1), fr.Grassmann(4, 2), fr.IsospectralOrbit((-1.0, 0.25, 1.5)),
    fr.IsospectralOrbit((0.0, 0.0, 1.0), hermitian=True),
    fr.CoadjointOrbit(fr.SO3(), (0.6, 0.0, -0.8)),
    fr.CoadjointOrbit(fr.SO3(), (0.3, 0.4, 1.2), "space"),
    fr.CoadjointOrbit(fr.SU(3), (0.5, -0.25, 1.0, 0.0, 0.75, 0.0, -0.5, 0.25)), CIRCLE, ELLIPSE,
]  # fmt: skip
SMALL_EXPONENTS = [
    fr.GL(1), fr.GL(2), fr.GL(3, "body"), fr.SL(2), fr.SL(3, "body"), fr.Sp(2), fr.Sp(4, "body"),
    fr.Semidirect(fr.SL(2)), fr.Semidirect(fr.SO(2, "space"), 2), fr.Semidirect(fr.SO3(), 2),
    fr.CoadjointOrbit(fr.SE3(), (0.5, 0.25, -0.5, 0.3, 0.2, 0.1)),
    fr.CoadjointOrbit(fr.SL(2), (0.5, 0.25, 0.75)),
    fr.CoadjointOrbit(fr.Semidirect(fr.SO(2)), (0.5, 0.25, 1.5), "space"), fr.SPD(1), fr.SPD(3),
    fr.Hyperbolic(2), fr.Hyperbolic(4), HEISENBERG,
    fr.MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]]]),
    fr.MatrixFrame([[[0.0, 1j], [1j, 0.0]], [[0.5, 0.0], [0.0, 1j]]], 2),
    fr.Product(fr.GL(2), fr.Sphere(2), fr.Sp(2)),
]  # fmt: skip
FLAT = [fr.Euclidean(1), fr.Euclidean(4)]
PRODUCTS = [
    fr.Product(fr.SO3()), fr.Product(fr.SO3(), fr.Euclidean(3)),
    fr.Product(fr.Euclidean(2), fr.Product(fr.SO3("space"), fr.SO3()), fr.Euclidean(1)),
    fr.Product(fr.SU(2), fr.UnitQuaternion(), fr.U(1)), fr.Power(fr.SO3(), 1),
    fr.Power(fr.Sphere(2), 3), fr.Power(fr.SU(3), 2),
    fr.Power(fr.Product(fr.SO3(), fr.Euclidean(1)), 2),
    fr.Product(fr.Power(fr.UnitQuaternion(), 2), fr.Euclidean(2)),
]  # fmt: skip
FRAMES = [
    *ROTATIONS, *FLAT, *PRODUCTS, *QUATERNIONS, *POSES, *COMPACT_GROUPS, *COMPACT_SPACES,
    *SMALL_EXPONENTS,
]  # fmt: skip
# Where flows grow exponentially, or like the square of time, far means not so far.
MAX_SCALE = dict.fromkeys(SMALL_EXPONENTS, 0.3)

# All of the array space, up to a set without interior.
OPEN = [
    *FLAT, fr.GL(1), fr.GL(2), fr.GL(3, "body"), fr.SPD(1), fr.Hyperbolic(2), fr.Hyperbolic(4),
    HEISENBERG, *SMALL_EXPONENTS[-3:-1],
]  # fmt: skip


def name(frame):
    text = repr(frame)
    return text if len(text) < 60 else f"{text[:57]}..."


def generic(frame, seed=11):
    """Return a smooth f that depends on time and every entry of the point, and a point."""
    rng = np.random.default_rng(seed)
    y0 = frame.random_point(rng)
    weights = rng.standard_normal((frame.dim, 2 * y0.size)) / np.sqrt(2 * y0.size)

    def f(t, y):
        flat = y.reshape(*y.shape[: y.ndim - y0.ndim], -1)
        both = np.concatenate([flat.real, flat.imag], axis=-1)
        return np.sin(both @ weights.T + np.arange(frame.dim) + np.asarray(t)[..., None])

    return f, y0


def condition(*points):
    """Return the factor by which rounding errors may grow: one on compact manifolds."""
    return float(np.prod([max(1.0, np.abs(point).max()) for point in points])) ** 2


def capped(frame, scale):
    return min(scale, MAX_SCALE.get(frame, np.inf))


def sample(frame, seed, scale):
    rng = np.random.default_rng(seed)
    return frame.random_point(rng), capped(frame, scale) * frame.random_vector(rng)
