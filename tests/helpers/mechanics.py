"""Mechanical systems: potentials linear in the entries of configurations, and joints."""

from dataclasses import dataclass

import numpy as np

import cg
from cg.frames import SO3, Euclidean, Joint, PhaseSpace, Power, Product

INERTIA = [1.0, 1.6, 2.3]
MATRIX = [[1.3, 0.1, 0.2], [0.1, 1.6, -0.3], [0.2, -0.3, 2.1]]
SPLITTINGS = [name for name, method in cg.methods.items() if isinstance(method, cg.Splitting)]


@dataclass
class System:
    """A potential Re <weights, q> on a phase space, and an initial point."""

    frame: PhaseSpace
    weights: np.ndarray
    y0: np.ndarray

    def f(self, t, y):
        configuration = self.frame.configuration
        shape = configuration.point_shape
        q = self.frame.split(y)[0].reshape(*y.shape[:-1], 1, *shape)
        fields = configuration.field(np.eye(configuration.dim), q)
        axes = tuple(range(-len(shape), 0))
        return -(self.weights.conj() * fields).real.sum(axis=axes)

    def energy(self, y):
        q, _ = self.frame.split(y)
        axes = tuple(range(-len(self.frame.configuration.point_shape), 0))
        return self.frame.kinetic_energy(y) + (self.weights.conj() * q).real.sum(axis=axes)

    def run(self, method, span=(0.0, 1.0), y0=None, **options):
        start = self.y0 if y0 is None else y0
        return cg.solve_ivp(self.f, span, start, frame=self.frame, method=method, **options)

    def reference(self, span=(0.0, 1.0), **options):
        return self.run("DOP853", span, rtol=1e-13, atol=1e-13, **options)


def system(configuration, inertia=None, seed=5):
    """Return a system with random weights and a random point."""
    rng = np.random.default_rng(seed)
    frame = PhaseSpace(configuration, inertia)
    shape = configuration.point_shape
    weights = rng.standard_normal(shape).astype(configuration.dtype)
    if configuration.dtype.kind == "c":
        weights += 1j * rng.standard_normal(shape)
    q = configuration.random_point(rng)
    return System(frame, weights, frame.join(q, rng.standard_normal(configuration.dim)))


GRAVITY = 9.81
INERTIAS = np.array([[0.2, 0.32, 0.46], [0.105, 0.165, 0.225]])
MASSES = np.array([1.3, 0.8])
BODIES = Product(SO3(), Euclidean(3), SO3(), Euclidean(3))
BODY_INERTIA = INERTIAS[0], MASSES[0], INERTIAS[1], MASSES[1]
TOP, BOTTOM, NEXT = [0.1, 0.2, 0.9], [-0.03, -0.16, -0.72], [-0.1, 0.15, 0.7]


class Linkage:
    """Bodies with joints that fall, and an initial point."""

    def __init__(self, frame, masses, q, momentum):
        self.frame, self.masses = frame, np.asarray(masses)
        self.y0 = frame.join(q, momentum)
        blocks = frame._bodies  # of attitude and position of each body in turn
        self.heights = [body.points.start + 2 for body in blocks[1::2]]
        self.forces = np.zeros(frame.rhs_dim)
        self.forces[[body.vectors.start + 2 for body in blocks[1::2]]] = -GRAVITY * self.masses

    def f(self, t, y):
        return self.forces

    def run(self, method, span, **options):
        options.setdefault("y0", self.y0)
        return cg.solve_ivp(self.f, span, frame=self.frame, method=method, **options)

    def energy(self, y):
        return self.frame.kinetic_energy(y) + GRAVITY * y[..., self.heights] @ self.masses


def double_pendulum(joints=None, **options):
    """Two bodies with three moments of inertia each, in ball joints."""
    if joints is None:
        joints = [
            Joint("ball", (None, np.zeros(3)), (0, TOP)),
            Joint("ball", (0, BOTTOM), (1, NEXT)),
        ]
    frame = PhaseSpace(BODIES, BODY_INERTIA, joints=joints, **options)
    turns = [SO3().flow(v, np.eye(3)) for v in ([0.4, 0.2, 0.0], [-0.3, 0.5, 0.1])]
    first = -turns[0] @ TOP
    q = BODIES.join(turns[0], first, turns[1], first + turns[0] @ BOTTOM - turns[1] @ NEXT)
    momentum = [0.1, 0.2, 0.8, 0, 0, 0, 0.05, -0.1, 0.3, 0, 0, 0]
    return Linkage(frame, MASSES, q, momentum)


def chain(n, kind="ball"):
    """A chain of n equal links of length one, stretched out and hung at one end."""
    end = [0.5, 0.0, 0.0], [0.0, 1.0, 0.0]
    start = [-0.5, 0.0, 0.0], [0.0, 1.0, 0.0]
    if kind == "ball":
        end, start = end[:1], start[:1]
    ground = (None, np.zeros(3), *end[1:])
    joints = [Joint(kind, (k - 1, *end) if k else ground, (k, *start)) for k in range(n)]
    frame = PhaseSpace(
        Power(Product(SO3(), Euclidean(3)), n), ([0.02, 0.09, 0.1], 1.0), joints=joints
    )
    q = np.zeros((n, 12))
    q[:, :9] = np.eye(3).ravel()
    q[:, 9] = np.arange(n) + 0.5
    return Linkage(frame, np.ones(n), q, np.zeros(6 * n))


def four_bar(closing):
    """Three links between two points of the ground, which turn about the third axis of space."""
    axis = [0.0, 0.0, 1.0]
    lengths = np.array([1.0, 2.0, 1.5])
    ends = [([-x / 2, 0, 0], [x / 2, 0, 0]) for x in lengths]
    pivots = [Joint("hinge", (None, np.zeros(3), axis), (0, ends[0][0], axis))]
    pivots.append(Joint("hinge", (0, ends[0][1], axis), (1, ends[1][0], axis)))
    pivots += closing(ends, axis)
    frame = PhaseSpace(
        Power(Product(SO3(), Euclidean(3)), 3), ([0.1, 0.2, 0.25], 1.0), joints=pivots
    )
    angles = np.array([1.1, 0.3, 1.4])
    q, start = np.zeros((3, 12)), np.zeros(3)
    for k, (angle, length) in enumerate(zip(angles, lengths, strict=True)):
        turn = SO3().flow([0.0, 0.0, angle], np.eye(3))
        if k == 2:  # its end is on the ground
            start = np.array([1.8, 0.0, 0.0])
        q[k] = [*turn.ravel(), *(start + turn @ [length / 2, 0.0, 0.0])]
        start = start + turn @ [length, 0.0, 0.0]
    return frame, q


def closed_by_hinges(ends, axis):
    return [
        Joint("hinge", (1, ends[1][1], axis), (2, ends[2][1], axis)),
        Joint("hinge", (None, [1.8, 0.0, 0.0], axis), (2, ends[2][0], axis)),
    ]


def closed_by_ball(ends, axis):
    return [
        Joint("ball", (1, ends[1][1]), (2, ends[2][1])),
        Joint("universal", (None, [1.8, 0.0, 0.0], axis), (2, ends[2][0], [0.0, 1.0, 0.0])),
    ]
