"""The inertia of mechanical systems: which metrics have free motions that are known exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.euclidean import Euclidean
from cg.frames.matrix_groups import U
from cg.frames.product import Power, Product, real_size
from cg.frames.quaternion import UnitQuaternion
from cg.frames.rotations import SO, hat, vee
from cg.frames.sphere import Sphere
from cg.support.arrays import Array, check_finite, real_array
from cg.support.checks import short

_ASYMMETRY = 1e-12  # largest asymmetry of a symmetric matrix, relative to its largest entry
_COMMUTATOR = 1e-12  # largest commutator of matrices that commute, relative to their entries
_KNOWN = "SO(n), UnitQuaternion, SU(n), U(n), Euclidean, Sphere(2), and products and powers of them"

Inertia = Any
"""None, a number, a diagonal, a matrix, or a tuple of these: hashable, as `PhaseSpace` keeps it."""


@dataclass(frozen=True, eq=False)
class Body:
    """The inertia of one factor of a configuration."""

    inverse: Array  # shape (n, n), or (n, 1) if it is diagonal
    root: Array  # R with the inertia R Rᵀ, of the same shape
    gyroscopic: Array | None  # antisymmetric B of a force B ω, shape (n, n)
    top: Array | None  # the numbers of `top_t` in Fortran, if the moments of inertia differ
    vectors: slice  # its velocities among all
    points: slice  # the doubles of its point among all
    sphere: bool = False  # whether it is a point of a sphere

    @property
    def commutes(self) -> bool:
        """Whether the flow of the gyroscopic force commutes with free motion."""
        if self.top is None or self.gyroscopic is None:
            return True
        inverse = rows_times(np.eye(3), self.inverse)
        axis = inverse @ vee(self.gyroscopic)
        commutator = inverse @ hat(axis) - hat(axis) @ inverse
        scale = np.abs(inverse).max() * np.abs(axis).max()
        return bool(np.abs(commutator).max() <= _COMMUTATOR * scale)


def rows_times(rows: Array, matrix: Array) -> Array:
    """Return rows times a matrix, of shape ``(n, 1)`` if it is diagonal."""
    return np.asarray(rows * matrix[:, 0] if matrix.shape[1] == 1 else rows @ matrix)


def compiled_bodies(bodies: tuple[Body, ...]) -> tuple[NDArray[np.intc], Array]:
    """Return the columns and the constants of bodies, as compiled code reads them.

    The columns are those of the inverse, as a negative number for a rigid body with a ``top``.
    """
    columns = [body.inverse.shape[1] * (1 if body.top is None else -1) for body in bodies]
    constants: list[Any] = []
    for body in bodies:
        constants += [*body.inverse.T.flat, *body.root.T.flat]
        if body.gyroscopic is None:
            constants.append(0.0)
        else:
            constants += [1.0 if body.commutes else 2.0, *body.gyroscopic.T.flat]
        constants += [] if body.top is None else [*body.top]
    return np.array(columns, dtype=np.intc), np.array(constants)


def hashable(value: Any) -> Any:
    """Return nested tuples of the numbers of sequences or arrays."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(map(hashable, value)) if isinstance(value, list | tuple) else value


def read_inertia(
    frame: Frame, value: Any, name: str = "inertia", gyroscopic: Any = None
) -> tuple[Inertia, tuple[Body, ...]]:
    """Return the inertia as hashable numbers, and the bodies of a configuration.

    ValueError if the free motion isn't known for the frame or for the inertia, or if this isn't
    positive definite.
    """
    bodies: list[Body] = []
    numbers = hashable(_read(frame, value, name, bodies))
    if gyroscopic is not None:
        matrices = gyroscopic_matrices(frame, gyroscopic)
        bodies = [
            replace(body, gyroscopic=matrix) for body, matrix in zip(bodies, matrices, strict=True)
        ]
    return numbers, tuple(bodies)


def _read(frame: Frame, value: Any, name: str, bodies: list[Body]) -> Inertia:
    """Append the bodies of a factor; return its inertia, None for the default."""
    if type(frame) is Product:
        return [_read(*factor, bodies) for factor in _of_each_factor(frame, value, name)]
    if type(frame) is Power:
        rows = _of_each_body(frame, value, name)
        if rows is None:
            for _ in range(frame.n):
                inertia = _read(frame.factor, value, name, bodies)
            return inertia
        for k, row in enumerate(rows):
            _read(frame.factor, row, f"{name}[{k}]", bodies)
        return rows
    _check_frame(frame)
    hint = ""
    if frame.dim == 3 and not isinstance(frame, Euclidean | Sphere):
        hint = "; a body without a moment about an axis, such as a linear rotor, is a Sphere(2)"
    matrix = _checked(value, frame.dim, name, hint)
    if matrix.ndim == 1:
        inverse, root = 1.0 / matrix[:, None], np.sqrt(matrix)[:, None]
    else:
        inverse = np.asarray(np.linalg.inv(matrix), np.float64)
        root = np.asarray(np.linalg.cholesky(matrix), np.float64)
        inverse = 0.5 * (inverse + inverse.T)
    vectors, points = (bodies[-1].vectors.stop, bodies[-1].points.stop) if bodies else (0, 0)
    slices = slice(vectors, vectors + frame.dim), slice(points, points + real_size(frame))
    top = _top(frame, matrix, name)
    bodies.append(Body(inverse, root, None, top, *slices, isinstance(frame, Sphere)))
    return None if value is None else matrix


def gyroscopic_matrices(frame: Frame, value: Any, name: str = "gyroscopic") -> list[Array | None]:
    """Return the antisymmetric matrix of each body of a configuration, None without one.

    ValueError if the motion isn't known with it, or if it isn't antisymmetric.
    """
    if type(frame) is Product:
        factors = _of_each_factor(frame, value, name)
        return [matrix for factor in factors for matrix in gyroscopic_matrices(*factor)]
    if type(frame) is Power:
        return frame.n * gyroscopic_matrices(frame.factor, value, name)
    if value is None:
        return [None]
    if not isinstance(frame, Euclidean) and (
        frame.dim != 3 or isinstance(frame, Sphere) or getattr(frame, "convention", "") != "body"
    ):
        raise ValueError(
            f"{name} must be None on {frame!r}: with such forces the motion is known on Euclidean "
            "space, and on rotations of space in body axes, as that of a body with a rotor"
        )
    matrix, n = real_array(value, name), frame.dim
    if matrix.shape == (3,) == (n,):
        matrix = hat(matrix)
    if matrix.shape != (n, n):
        raise ValueError(f"{name} must have shape {(n, n)}, got {matrix.shape}")
    check_finite(name, matrix)
    if np.abs(matrix + matrix.T).max() > _ASYMMETRY * np.abs(matrix).max():
        raise ValueError(
            f"{name} must be antisymmetric, or else it does work; friction is that of "
            f"thermostat=cg.Langevin, got {short(value)}"
        )
    return [(matrix - matrix.T) / 2]


def _of_each_factor(frame: Product, value: Any, name: str) -> list[tuple[Frame, Any, str]]:
    """Return the factors of a product, and the value of each with its name."""
    values = (None,) * len(frame.factors) if value is None else value
    if not isinstance(values, tuple | list) or len(values) != len(frame.factors):
        raise ValueError(
            f"{name} must be a tuple of {len(frame.factors)}, one of each factor, got "
            f"{short(value)}"
        )
    names = [f"{name}[{k}]" for k in range(len(values))]
    return [*zip(frame.factors, values, names, strict=True)]


def _of_each_body(frame: Power, value: Any, name: str) -> Array | None:
    """Return the inertia of each body of a power, None if all have one inertia."""
    n, dim = frame.n, frame.factor.dim
    if type(frame.factor) in (Power, Product) or np.ndim(value) < 2:
        return None
    rows = real_array(value, name)
    if rows.shape == (n, dim) == (dim, n) != (1, 1):
        raise ValueError(
            f"{name} must have shape {(n, dim, dim)} or ({dim},) on {frame!r}, where shape "
            f"{(n, dim)} may mean one matrix or {n} diagonals"
        )
    if rows.shape == (dim, dim):
        return None
    if rows.shape not in ((n, 1), (n, dim), (n, dim, dim)):
        raise ValueError(
            f"{name} must have shape ({dim},), {(dim, dim)}, or one for each body, {(n, dim)} or "
            f"{(n, dim, dim)}, got {rows.shape}"
        )
    return np.broadcast_to(rows, (n, dim)) if rows.shape == (n, 1) else rows


def _check_frame(frame: Frame) -> None:
    """Raise ValueError unless the free motion on a frame is known for some inertia."""
    if not isinstance(frame, SO | UnitQuaternion | U | Euclidean | Sphere):
        raise ValueError(
            f"frame must be one whose free motion is known exactly, {_KNOWN}, got {frame!r}"
        )
    if frame.compiled_blocks() is None:
        raise ValueError(f"frame must be compiled, {_KNOWN}, n at most 12; {frame!r} is not")


def _checked(value: Any, n: int, name: str, hint: str) -> Array:
    """Return a positive definite inertia: its diagonal, or a matrix that isn't diagonal."""
    matrix = real_array(1.0 if value is None else value, name)
    if matrix.shape not in ((), (n,), (n, n)):
        raise ValueError(f"{name} must have shape ({n},) or ({n}, {n}), got {matrix.shape}")
    check_finite(name, matrix)
    if matrix.ndim < 2:
        matrix = np.full(n, matrix)
    elif np.array_equal(matrix, np.diag(np.diagonal(matrix))):
        matrix = np.diagonal(matrix).copy()
    elif np.abs(matrix - matrix.T).max() > _ASYMMETRY * np.abs(matrix).max():
        raise ValueError(f"{name} must be symmetric, got {short(value)}")
    smallest = matrix.min() if matrix.ndim == 1 else np.linalg.eigvalsh(matrix)[0]
    if not smallest > 0.0:
        raise ValueError(f"{name} must be positive definite, got {short(value)}{hint}")
    return matrix


def _top(frame: Frame, matrix: Array, name: str) -> Array | None:
    """Return the numbers of a rigid body, None if its free motion is one flow."""
    if isinstance(frame, Euclidean) or (matrix.ndim == 1 and (matrix == matrix[0]).all()):
        return None
    if frame.dim != 3 or isinstance(frame, Sphere):
        raise ValueError(
            f"{name} must be a multiple of the identity on {frame!r}, got {matrix.tolist()}: only "
            "of this metric, which is invariant on both sides, the free motion is a flow"
        )
    if getattr(frame, "convention", "") != "body":
        raise ValueError(
            f"{name} must be a multiple of the identity on {frame!r}, got {matrix.tolist()}: in "
            "space axes it changes with the attitude; take convention='body'"
        )
    moments, axes = _principal(matrix)
    inverse = [1 / Fraction(moment) for moment in moments.tolist()]
    gaps = inverse[0] - inverse[1], inverse[1] - inverse[2], inverse[0] - inverse[2]
    lower = np.zeros((3, 3)) if matrix.ndim == 1 else _lower_digits(axes)
    return np.array([*axes.T.ravel(), *lower.T.ravel(), *map(float, (*inverse, *gaps))])


def _lower_digits(axes: Array) -> Array:
    """Return the term that, added to a rounded rotation, makes it orthogonal to twice the digits.

    It is a step of Newton and Schulz with an exact residual.
    """
    exact = np.array([[Fraction(x) for x in row] for row in axes.tolist()])
    residual = exact.T @ exact - np.array([[Fraction(i == j) for j in range(3)] for i in range(3)])
    return np.asarray(-0.5 * axes @ residual.astype(np.float64))


def _principal(matrix: Array) -> tuple[Array, Array]:
    """Return increasing moments of inertia, and their axes as the columns of a rotation."""
    if matrix.ndim == 1:
        order = np.argsort(matrix, kind="stable")
        moments, axes = matrix[order], np.eye(3)[:, order]
    else:
        moments, axes = np.linalg.eigh(matrix)
    return moments, axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
