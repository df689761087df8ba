"""Manifolds as formulas for y' = sum of v_i E_i(y), in the space around them.

A space has the expression that makes the frame, a point from which others are reached, and its
fields. They are written down from the table of `docs/frames.md`, without `cg`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

Field = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Space:
    """A frame: its expression, one point, the number of coefficients, and the derivative of y.

    ``field(v, y)`` takes what a right-hand side returns: coefficients, on phase spaces forces.
    ``brackets``, ``phase``, ``compiled`` and ``entries`` say which methods it has, whether it is a
    phase space, whether right-hand sides in C run without Python, and whether tolerances are those
    of entries of points. ``along`` takes coordinates of a tangent, where ``field`` takes others.
    """

    expression: str
    base: np.ndarray
    dim: int
    field: Field
    brackets: bool = True
    phase: bool = False
    compiled: bool = False
    entries: bool = False
    returned: tuple[int, ...] = (-1,)
    prelude: str = ""
    along: Field | None = None

    @property
    def coordinates(self) -> int:
        """The number of coordinates of a tangent."""
        return self.dim * (1 + self.phase)

    def tangent(self, xi: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the reals of the tangent with given coordinates."""
        return reals((self.along or self.field)(xi, y))

    def start(self, seed: int) -> np.ndarray:
        """Return a point: that which a random constant v leads to from the base."""
        v = np.random.default_rng(seed).uniform(-1.0, 1.0, self.dim)
        shape, dtype = self.base.shape, self.base.dtype

        def derivative(_, z):
            return reals(self.field(v, z.view(dtype).reshape(shape)))

        run = solve_ivp(
            derivative, (0.0, 1.0), reals(self.base), method="DOP853", rtol=1e-13, atol=1e-15
        )
        return run.y[:, -1].copy().view(dtype).reshape(shape)


def reals(y: np.ndarray) -> np.ndarray:
    """Return the real and imaginary parts of the entries as one vector."""
    return np.ascontiguousarray(y).reshape(-1).view(float)


def skew(n: int) -> np.ndarray:
    """Return the basis of so(n): signs as in so(3), the last pair of axes first."""
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n)][::-1]
    basis = np.zeros((len(pairs), n, n))
    for matrix, (i, j) in zip(basis, pairs, strict=True):
        matrix[j, i] = (-1.0) ** (i + j + 1)
        matrix[i, j] = -matrix[j, i]
    return basis


def moved_by(basis: np.ndarray, side: str) -> Field:
    """Return the field of matrices that act from a side, or from both."""
    actions: dict[str, Field] = {
        "left": lambda omega, y: omega @ y,
        "right": lambda omega, y: y @ omega,
        "congruent": lambda omega, y: omega @ y + y @ omega.T,
        "similar": lambda omega, y: omega @ y - y @ omega,
    }
    act, rows, shape = actions[side], basis.reshape(len(basis), -1), basis.shape[1:]
    return lambda v, y: act((v @ rows).reshape(shape), y)


PAULI = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])


def rigid(convention: str) -> Field:
    basis = np.zeros((6, 4, 4))
    basis[:3, :3, :3] = skew(3)
    basis[3:, :3, 3] = np.eye(3)
    return moved_by(basis, convention)


def cross(v: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the cross product of two vectors, in a tenth of the time of NumPy's."""
    (a, b, c), (d, e, f) = v.tolist(), y.tolist()
    return np.array([b * f - c * e, c * d - a * f, a * e - b * d])


def quaternion(v: np.ndarray, q: np.ndarray, sign: float = 1.0) -> np.ndarray:
    """Return q v / 2, scalar last, with the other sign v q / 2."""
    vector = q[3] * v + sign * cross(q[:3], v)
    return 0.5 * np.append(vector, -q[:3] @ v)


def ambient_stiefel(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the part of x, read row by row, that is tangent at y."""
    x = x.reshape(y.shape)
    return x - y @ (y.T @ x + x.T @ y) / 2


def product(*spaces: Space) -> Space:
    """Return the product, whose points are one flat vector."""

    def field(v, y):
        parts = []
        for space in spaces:
            size = reals(space.base).size
            point = y[:size].view(space.base.dtype).reshape(space.base.shape)
            parts.append(reals(space.field(v[: space.dim], point)))
            v, y = v[space.dim :], y[size:]
        return np.concatenate(parts)

    return Space(
        f"cg.frames.Product({', '.join(space.expression for space in spaces)})",
        np.concatenate([reals(space.base) for space in spaces]),
        sum(space.dim for space in spaces),
        field,
        all(space.brackets for space in spaces),
        compiled=all(space.compiled for space in spaces),
    )


def power(space: Space, n: int) -> Space:
    def field(v, y):
        return np.stack([space.field(*part) for part in zip(v.reshape(n, -1), y, strict=True)])

    base = np.stack([space.base] * n)
    return Space(
        f"cg.frames.Power({space.expression}, {n})", base, n * space.dim, field, space.brackets,
        compiled=space.compiled,
    )  # fmt: skip


def phase(space: Space, inertia: list[float], turning: bool) -> Space:
    """Return the phase space of a configuration with one moment for each momentum.

    In body axes, where ``turning`` is true, a momentum m changes by m × ω. On spheres forces along
    the point have no effect.
    """
    moments, size = np.array(inertia), reals(space.base).size

    def field(force, y):
        q, momentum = y[:size].reshape(space.base.shape), y[size:]
        velocity = momentum / moments
        change = turning * cross(momentum, velocity) if turning else 0.0
        if space is SPHERE:
            force = force - q * (q @ force)
        return np.concatenate([space.field(velocity, q).reshape(-1), change + force])

    def along(xi, y):
        velocity = space.field(xi[: space.dim], y[:size].reshape(space.base.shape))
        return np.append(velocity, xi[space.dim :])

    base = np.concatenate([reals(space.base), np.zeros(space.dim)])
    text = f"cg.frames.PhaseSpace({space.expression}, {inertia if turning else inertia[0]})"
    return Space(text, base, space.dim, field, phase=True, along=along)


def hung(mass: float) -> Space:
    """Return the phase space of a point mass on a rod of length one."""

    def field(force, y):
        q, momentum = y[:3], y[3:]
        rod = q @ force + momentum @ momentum / mass
        return np.concatenate([momentum / mass, force - rod * q])

    def along(xi, y):
        q, step = y[:3], xi[:3] - y[:3] * (y[:3] @ xi[:3])
        return np.concatenate([step, xi[3:] - q * (q @ xi[3:] + step @ y[3:])])

    rod = "cg.frames.Joint('distance', (None, np.zeros(3)), (0, np.zeros(3)), length=1.0)"
    text = f"cg.frames.PhaseSpace(cg.frames.Euclidean(3), {mass}, joints=[{rod}])"
    base = np.append(np.eye(3)[2], np.zeros(3))
    return Space(text, base, 3, field, phase=True, along=along)


def matrices(name: str, basis: np.ndarray, side: str, brackets: bool = True) -> Space:
    """Return linear fields of a frame of the user; points are vectors."""
    text = f"cg.frames.{name}({basis.tolist()})"
    return Space(
        text, np.eye(basis.shape[-1])[0], len(basis), moved_by(basis, side), brackets, entries=True
    )


CIRCLE = """
def along(y): return np.array([-y[1], y[0]])
def flow(v, y): return np.array([[np.cos(v[0]), -np.sin(v[0])], [np.sin(v[0]), np.cos(v[0])]]) @ y
"""

ROTATIONS, UNITS = skew(3), np.eye(4).reshape(4, 2, 2)
LINE = Space("cg.frames.Euclidean(1)", np.zeros(1), 1, lambda v, y: v, compiled=True)
PLANE = Space("cg.frames.Euclidean(2)", np.zeros(2), 2, lambda v, y: v, compiled=True)
BODY = Space("cg.frames.SO3()", np.eye(3), 3, moved_by(ROTATIONS, "right"), compiled=True)
SPHERE = Space("cg.frames.Sphere(2)", np.eye(3)[2], 3, cross, compiled=True)
QUATERNION = Space("cg.frames.UnitQuaternion()", np.eye(4)[3], 3, quaternion, compiled=True)
SPIN = Space("cg.frames.SU(2)", np.eye(2) + 0j, 3, moved_by(-0.5j * PAULI, "left"), compiled=True)

SPACES = (
    LINE, PLANE, BODY, SPHERE, QUATERNION, SPIN,
    Space("cg.frames.SO3('space')", np.eye(3), 3, moved_by(ROTATIONS, "left"), compiled=True),
    Space("cg.frames.UnitQuaternion('space')", np.eye(4)[3], 3,
          lambda v, q: quaternion(v, q, -1.0), compiled=True),
    Space("cg.frames.SE3()", np.eye(4), 6, rigid("right"), compiled=True),
    Space("cg.frames.SO(4)", np.eye(4), 6, moved_by(skew(4), "right"), compiled=True),
    Space("cg.frames.SO(2, 'space')", np.eye(2), 1, moved_by(skew(2), "left"), compiled=True),
    Space("cg.frames.GL(2)", np.eye(2), 4, moved_by(UNITS, "left")),
    Space("cg.frames.SPD(2)", np.eye(2), 4, moved_by(UNITS, "congruent"), entries=True),
    Space("cg.frames.Stiefel(3, 2)", np.eye(3, 2), 3, moved_by(ROTATIONS, "left"),
          entries=True),
    Space("cg.frames.Stiefel(3, 2)", np.eye(3, 2), 6, ambient_stiefel, False, entries=True,
          returned=(3, 2)),
    Space("cg.frames.Grassmann(3, 1)", np.diag([1.0, 0, 0]), 3, moved_by(ROTATIONS, "similar"),
          entries=True),
    Space("cg.frames.IsospectralOrbit((-1.0, 0.25, 1.5))", np.diag([-1.0, 0.25, 1.5]), 3,
          moved_by(ROTATIONS, "similar"), compiled=True, entries=True),
    Space("cg.frames.Hyperbolic(2)", np.array([0.0, 1.0]), 2,
          lambda v, y: v[0] * y + np.array([v[1], 0.0])),
    Space("cg.frames.CoadjointOrbit(cg.frames.SO3(), (0.6, 0.0, -0.8))", np.array([0.6, 0.0, -0.8]),
          3, lambda v, y: cross(y, v)),
    matrices("LinearAction", np.array([[[0, -1.0, 0], [1.0, 0, 0], [0, 0, 0]],
                                       [[0, 0, 0], [0, 0, -0.5], [0, 0.5, 0]]]), "left", False),
    matrices("MatrixFrame", np.array([[[0, -0.5], [2.0, 0]]]), "left"),
    Space("cg.frames.FieldFrame([along], flow, point_shape=2)", np.array([1.0, 0.0]), 1,
          moved_by(skew(2), "left"),
          entries=True, prelude=CIRCLE),
    product(BODY, PLANE), product(SPIN, LINE, SPHERE), power(SPHERE, 2), power(QUATERNION, 2),
    phase(BODY, [1.0, 1.5, 2.0], True), phase(PLANE, [1.5, 1.5], False),
    phase(SPHERE, [1.5, 1.5, 1.5], False), hung(1.5),
)  # fmt: skip
