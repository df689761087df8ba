"""Collocation methods on Lie algebras: their stages in compiled code, and Jacobians from Python."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.python import PythonRhs, when
from cg.method.method import Method
from cg.method.munthe_kaas import MuntheKaas

if TYPE_CHECKING:
    from cg.integration.variational.field import VariationalField


def is_collocation(method: Method) -> bool:
    """Return whether the stages of a method are solved by Newton's method in compiled code."""
    return isinstance(method, MuntheKaas) and not method.explicit


def collocation_polynomial(c: Array) -> Array:
    """Return the integrals of Lagrange's polynomials at nodes, of θ, θ², …: ``(powers, nodes)``."""
    powers = np.arange(len(c))
    return np.asarray(np.linalg.inv(c[:, None] ** powers) / (powers + 1.0)[:, None])


def transformation(method: MuntheKaas) -> tuple[Fraction, ...]:
    """Return the entries of ``transformation_t`` in ``fortran/steps/newton.f90``, by columns."""
    inverse = np.linalg.inv(method.a[1:, 1:])
    values, vectors = np.linalg.eig(inverse)
    real, pair = np.argmin(np.abs(values.imag)), np.argmin(values.imag)
    basis = np.column_stack([vectors[:, real].real, vectors[:, pair].real, vectors[:, pair].imag])
    matrices = inverse, basis, np.linalg.inv(basis), collocation_polynomial(method.c[1:])
    eigenvalues = values[real].real, values[pair].real, -values[pair].imag
    numbers = np.concatenate([*(matrix.ravel(order="F") for matrix in matrices), eigenvalues])
    return tuple(map(Fraction, numbers.tolist()))


@dataclass(frozen=True, eq=False)
class Jacobian:
    """The Jacobian of a right-hand side, from a function of the user.

    Compiled code factors dense matrices by LAPACK; sparse ones are kept and factored here.

    Attributes
    ----------
    source
        Evaluates the function.
    sparse
        Whether it returns sparse matrices of SciPy.
    rhs
        The right-hand side of the run, whose arguments the function receives.
    kept
        Of each member the sparse matrix and its factors, the latest used last.
    """

    source: VariationalField
    sparse: bool = False
    rhs: CompiledRhs | PythonRhs | None = None
    kept: dict[int, list[Any]] = field(default_factory=dict)

    def of(self, rhs: CompiledRhs | PythonRhs) -> Jacobian:
        """Return the Jacobian of a right-hand side."""
        return replace(self, rhs=rhs, kept={})

    def arguments(self, member: int) -> tuple[Any, ...]:
        """Return the further arguments of the function for a member."""
        if isinstance(self.rhs, PythonRhs):
            return self.rhs.arguments(member)
        numbers = None if self.rhs is None else self.rhs.parameters
        return () if numbers is None else (numbers[member],)

    def value(self, member: int, t: float, y: Points) -> Any:
        """Return the matrix at a point, after checking it."""
        assert self.rhs is not None
        arguments, numbers = self.arguments(member), self.rhs.parameters
        if self.source.vectorized:
            if numbers is not None:
                arguments = *arguments[:-1], numbers[member : member + 1]
            return self.source.jacobian(np.array([t]), y[None], arguments)[0]
        y.flags.writeable = False
        if not self.sparse:
            return self.source.jacobian(t, y, arguments)
        value, n = self.source.jac(t, y, *arguments), self.source.frame.dim
        if getattr(value, "shape", None) != (n, n):
            raise ValueError(f"jac must return a matrix of shape {(n, n)}, got {value!r}")
        if not hasattr(value, "tocsc"):
            raise ValueError(f"jac must return a sparse matrix at all times, got {value!r}")
        matrix = value.tocsc()
        if matrix.dtype.kind not in "biuf":
            raise ValueError(f"jac must return real numbers, got {value!r} at {when(t)}")
        matrix = matrix.astype(np.float64)
        if not np.isfinite(matrix.data).all():
            raise ValueError(f"jac must return finite numbers, got {value!r} at {when(t)}")
        return matrix

    def evaluate(self, member: int, t: float, y: Points, slope: Array, lanes: int) -> Array:
        """Return the matrix column by column, or nothing if it is sparse and kept here."""
        matrix = self.value(member, t, y)
        if not self.sparse:
            return np.asarray(matrix.T)
        from scipy.sparse import csc_array

        # the derivative of dexp⁻¹ along u is -[u, f] / 2
        brackets = self.source.frame.bracket(-0.5 * np.eye(len(slope)), slope).T
        while len(self.kept) >= lanes and member not in self.kept:
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
        n = self.source.frame.dim
        if len(b) == n:
            return np.asarray(first.solve(b))
        x = second.solve(b[:n] + 1j * b[n:])
        return np.concatenate([x.real, x.imag])


def jacobian_of(
    jac: Any,
    f: Any,
    frame: Frame,
    method: Method,
    rhs: CompiledRhs | PythonRhs,
    t: float,
    y: Points,
) -> Jacobian:
    """Return the Jacobian that ``jac`` evaluates, after calling it at the initial point."""
    from cg.integration.variational.field import VariationalField
    from cg.integration.variational.problem import check_by_differences, check_function

    if not is_collocation(method):
        raise ValueError(f'jac must be None unless method="RadauIIA5", and it is {method!r}')
    check_by_differences(frame, jac=jac)
    check_function(jac, "jac", rhs.vectorized)
    count = 0 if rhs.parameters is None else rhs.parameters.shape[-1]
    jacobian = Jacobian(VariationalField(frame, f, jac, None, count, rhs.vectorized), rhs=rhs)
    if not (rhs.vectorized or isinstance(jacobian.source.jac, CompiledRhs)):
        value = jac(t, y.copy(), *jacobian.arguments(0))
        jacobian = replace(jacobian, sparse=hasattr(value, "tocsc"))
    jacobian.value(0, t, y.copy())
    return replace(jacobian, rhs=None)
