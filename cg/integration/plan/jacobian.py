"""Jacobians for Newton's method, from a function of the user."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from cg.frames.base import Frame
from cg.integration.rhs.checks import when
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.given_derivatives import Derivative, derivative_of
from cg.integration.rhs.inputs import data_at
from cg.integration.rhs.python import PythonRhs
from cg.support.arrays import Array, Points
from cg.tables import Kind, MethodTable

Rhs = CompiledRhs | PythonRhs


def _constant(matrix: Any, t: Any, *_: Any) -> Any:
    """Return a matrix that was given as ``jac``, or a stack of it for an array of times."""
    return matrix if np.ndim(t) == 0 else np.broadcast_to(matrix, (*t.shape, *matrix.shape))


@dataclass(frozen=True, eq=False)
class Jacobian:
    """The Jacobian of a right-hand side.

    Compiled code factors dense matrices by LAPACK; sparse ones are kept and factored here.
    """

    derivative: Derivative
    sparse: bool = False  # whether the function returns sparse matrices of SciPy
    constant: bool = False  # whether a matrix was given, which isn't counted as evaluated
    lanes: int = 1  # how many members are integrated at the same time
    # by member: the sparse matrix and its factors, the latest used last
    kept: dict[int, list[Any]] = field(default_factory=dict)

    def value(self, rhs: Rhs, member: int, t: float, y: Points) -> Any:
        """Return the matrix at a point, after checking it."""
        arguments, numbers = rhs.arguments(member), rhs.parameters
        if rhs.vectorized:
            arguments = rhs.arguments(np.array([member]))
            return self.derivative(np.array([t]), y[None], arguments)[0]
        if not self.sparse:
            data = data_at(t, arguments, numbers is not None)
            own = rhs.user_data if isinstance(rhs, CompiledRhs) else 0
            return self.derivative(t, y, arguments, own if data is None else data.ctypes.data)
        y.flags.writeable = False
        value, shape = self.derivative.function(t, y, *arguments), self.derivative.shape
        if getattr(value, "shape", None) != shape:
            raise ValueError(f"jac must return a matrix of shape {shape}, got {value!r}")
        if not hasattr(value, "tocsc"):
            raise ValueError(f"jac must return a sparse matrix at all times, got {value!r}")
        matrix = value.tocsc()
        if matrix.dtype.kind not in "biuf":
            raise ValueError(f"jac must return real numbers, got {value!r} at {when(t)}")
        matrix = matrix.astype(np.float64)
        if not np.isfinite(matrix.data).all():
            raise ValueError(f"jac must return finite numbers, got {value!r} at {when(t)}")
        return matrix

    def evaluate(self, rhs: Rhs, member: int, t: float, y: Points, slope: Array) -> Array:
        """Return the matrix column by column, or nothing if it is sparse and kept here."""
        matrix = self.value(rhs, member, t, y)
        if not self.sparse:
            return np.asarray(matrix.T)
        from scipy.sparse import csc_array

        # the derivative of dexp⁻¹ along u is -[u, f] / 2
        brackets = self.derivative.frame.bracket(-0.5 * np.eye(len(slope)), slope).T
        while len(self.kept) >= self.lanes and member not in self.kept:
            del self.kept[next(iter(self.kept))]
        self.kept[member] = [csc_array(matrix + csc_array(brackets))]
        return np.zeros(1)

    def factor(self, member: int, shifts: tuple[complex, ...]) -> Array:
        """Factor the matrix subtracted from multiples of the identity; return 1 if it fails."""
        from scipy.sparse import eye_array
        from scipy.sparse.linalg import splu

        matrix = self.kept.pop(member)[0]
        identity: Any = eye_array(matrix.shape[0], format="csc")
        try:
            factors = [splu(shift * identity - matrix) for shift in shifts]
        except RuntimeError:  # a singular matrix
            return np.ones(1)
        finally:
            self.kept[member] = [matrix]
        self.kept[member] += factors
        return np.zeros(1)

    def solve(self, member: int, b: Array) -> Array:
        """Return the solution of the real or, of twice as many numbers, the complex system."""
        _, first, second = self.kept[member]
        n = self.derivative.frame.dim
        if len(b) == n:
            return np.asarray(first.solve(b))
        x = second.solve(b[:n] + 1j * b[n:])
        return np.concatenate([x.real, x.imag])


def jacobian_of(
    jac: Any, frame: Frame, method: MethodTable, rhs: Rhs, t: float, y: Points
) -> Jacobian:
    """Return the Jacobian that ``jac`` evaluates, after calling it at the initial point."""
    if method.kind is not Kind.COLLOCATION:
        raise ValueError(f'jac must be None unless method="RadauIIA5", and it is {method!r}')
    constant = isinstance(jac, np.ndarray | list | tuple) or hasattr(jac, "tocsc")
    if constant:
        dense = jac.toarray() if rhs.vectorized and hasattr(jac, "tocsc") else jac
        jac = partial(_constant, dense if hasattr(dense, "tocsc") else np.asarray(dense))
    shape = frame.dim, frame.dim
    derivative = derivative_of(jac, "jac", frame, shape, rhs.vectorized, rhs.inputs)
    assert derivative is not None
    sparse = False
    if not (rhs.vectorized or isinstance(derivative.function, CompiledRhs)):
        sparse = hasattr(derivative.function(t, y.copy(), *rhs.arguments(0)), "tocsc")
    jacobian = Jacobian(derivative, sparse, constant)
    jacobian.value(rhs, 0, t, y.copy())
    return jacobian
