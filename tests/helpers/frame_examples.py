"""Frames for the tests of axioms: one of every kind, with its particulars."""

import numpy as np

from cg.frames import (
    GL,
    SE3,
    SL,
    SO,
    SO3,
    SPD,
    SU,
    CoadjointOrbit,
    Euclidean,
    FieldFrame,
    Grassmann,
    Hyperbolic,
    IsospectralOrbit,
    MatrixFrame,
    Power,
    Product,
    Semidirect,
    Sp,
    Sphere,
    Stiefel,
    U,
    UnitQuaternion,
)

# y0' = v0, y1' = v1, y2' = y0 v1 - y1 v0: the Heisenberg group acts on space.
HEISENBERG = FieldFrame(
    [lambda y: np.array([1.0, 0.0, -y[1]]), lambda y: np.array([0.0, 1.0, y[0]])],
    lambda v, y: y + np.array([v[0], v[1], y[0] * v[1] - y[1] * v[0]]),
    point_shape=3,
)

# A phase on the unit circle of the complex plane.
CIRCLE = FieldFrame(
    [lambda z: 1j * z],
    lambda v, z: z * np.exp(1j * v[0]),
    point_shape=(1,),
    dtype=complex,
    membership_error=lambda z: abs(abs(z[0]) - 1.0),
    restore=lambda z: z * (1.5 - 0.5 * abs(z) ** 2),
    project=lambda z: z / abs(z),
    distance=lambda x, z: abs(np.angle(z[0] * x[0].conj())),
    exp_coordinates=lambda x, z: [np.angle(z[0] * x[0].conj())],
    random_point=lambda rng: np.exp([2j * np.pi * rng.random()]),
)

# The ellipse 4 x^2 + y^2 = 4, traversed with a period of pi.
ELLIPSE = MatrixFrame(
    [[[0.0, -1.0], [4.0, 0.0]]],
    membership_error=lambda y: abs(np.sqrt(y[0] ** 2 + y[1] ** 2 / 4.0) - 1.0),
    restore=lambda y: y / np.sqrt(y[0] ** 2 + y[1] ** 2 / 4.0),
    project=lambda y: y / np.sqrt(y[0] ** 2 + y[1] ** 2 / 4.0),
    random_point=lambda rng: np.array([1.0, 2.0]) * Sphere(1).random_point(rng),
)

HEISENBERG_CONSTANTS = (
    ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, -1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
)

ROTATIONS = [SO3(), SO3("space")]
QUATERNIONS = [
    *(UnitQuaternion(), UnitQuaternion("space"), UnitQuaternion(scalar_first=True)),
    UnitQuaternion("space", scalar_first=True),
]
POSES = [SE3(), SE3("space")]
COMPACT_GROUPS = [
    *(SO(2), SO(3, "space"), SO(4), SO(5, "space"), U(1), U(2, "body"), U(3), SU(2)),
    *(SU(2, "body"), SU(3), SU(4, "body")),
]
COMPACT_SPACES = [
    Sphere(1),
    Sphere(2),
    Sphere(4),
    Stiefel(4, 2),
    Stiefel(3, 3),
    Grassmann(3, 1),
    Grassmann(4, 2),
    IsospectralOrbit((-1.0, 0.25, 1.5)),
    IsospectralOrbit((0.0, 0.0, 1.0), hermitian=True),
    CoadjointOrbit(SO3(), (0.6, 0.0, -0.8)),
    CoadjointOrbit(SO3(), (0.3, 0.4, 1.2), "space"),
    CoadjointOrbit(SU(3), (0.5, -0.25, 1.0, 0.0, 0.75, 0.0, -0.5, 0.25)),
    CIRCLE,
    ELLIPSE,
]
SMALL_EXPONENTS = [
    GL(1),
    GL(2),
    GL(3, "body"),
    SL(2),
    SL(3, "body"),
    Sp(2),
    Sp(4, "body"),
    Semidirect(SL(2)),
    Semidirect(SO(2, "space"), 2),
    Semidirect(SO3(), 2),
    CoadjointOrbit(SE3(), (0.5, 0.25, -0.5, 0.3, 0.2, 0.1)),
    CoadjointOrbit(SL(2), (0.5, 0.25, 0.75)),
    CoadjointOrbit(HEISENBERG_CONSTANTS, (0.5, 0.25, 1.5), "space"),
    SPD(1),
    SPD(3),
    Hyperbolic(2),
    Hyperbolic(4),
    HEISENBERG,
    MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]]]),
    MatrixFrame([[[0.0, 1j], [1j, 0.0]], [[0.5, 0.0], [0.0, 1j]]], 2),
    Product(GL(2), Sphere(2), Sp(2)),
]
FLAT = [Euclidean(1), Euclidean(4)]
PRODUCTS = [
    Product(SO3()),
    Product(SO3(), Euclidean(3)),
    Product(Euclidean(2), Product(SO3("space"), SO3()), Euclidean(1)),
    Product(SU(2), UnitQuaternion(), U(1)),
    Power(SO3(), 1),
    Power(Sphere(2), 3),
    Power(SU(3), 2),
    Power(Product(SO3(), Euclidean(1)), 2),
    Product(Power(UnitQuaternion(), 2), Euclidean(2)),
]
FRAMES = [
    *ROTATIONS,
    *FLAT,
    *PRODUCTS,
    *QUATERNIONS,
    *POSES,
    *COMPACT_GROUPS,
    *COMPACT_SPACES,
    *SMALL_EXPONENTS,
]
# Where flows grow exponentially, or like the square of time, far means not so far.
MAX_SCALE = dict.fromkeys(SMALL_EXPONENTS, 0.3)

# All of the array space, up to a set without interior.
OPEN = [
    *FLAT,
    GL(1),
    GL(2),
    GL(3, "body"),
    SPD(1),
    Hyperbolic(2),
    Hyperbolic(4),
    HEISENBERG,
    *SMALL_EXPONENTS[-3:-1],
]


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
