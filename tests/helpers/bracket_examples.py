"""Frames with brackets."""

import numpy as np
from frame_examples import FRAMES

from cg import frames as fr
from cg.frames.facts import facts_of

CLOSED = fr.MatrixFrame(
    [[[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]]]
)
HEISENBERG_GROUP = fr.FieldFrame(
    [
        lambda y: np.array([1.0, 0.0, -y[1]]),
        lambda y: np.array([0.0, 1.0, y[0]]),
        lambda y: np.array([0.0, 0.0, 1.0]),
    ],
    lambda v, y: y + np.array([v[0], v[1], v[2] + y[0] * v[1] - y[1] * v[0]]),
    point_shape=3,
    bracket=lambda u, v: [0.0, 0.0, 2.0 * (u[1] * v[0] - u[0] * v[1])],
)


WITH = [frame for frame in [*FRAMES, CLOSED, HEISENBERG_GROUP] if facts_of(frame).has_brackets]
CLOSED_COORDINATES = [
    fr.SO3(), fr.SO3("space"), fr.UnitQuaternion(), fr.SU(2), fr.SU(2, "body"), fr.SE3(),
    fr.SE3("space"), fr.Semidirect(fr.SO3(), 2), fr.Sphere(2),
    fr.CoadjointOrbit(fr.SO3(), (0.6, 0.0, -0.8)), fr.Euclidean(3),
    fr.Product(fr.SE3(), fr.SO3("space")),
]  # fmt: skip


def vectors(frame, seed, count):
    return np.random.default_rng(seed).standard_normal((count, frame.dim))
