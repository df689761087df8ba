"""Checks of the user's covariances: of initial points, and spectral densities of noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.integration.problem import Problem
from cg.integration.rhs.compiled import CompiledRhs, compiled_rhs
from cg.integration.rhs.python import Derivative, derivative_of, time_text
from cg.support.arrays import Array, Points, check_finite, real_array

# largest asymmetry, and negative eigenvalue, relative to the largest entry or eigenvalue
_COVARIANCE_ERROR = 1e-9


@dataclass(frozen=True, eq=False)
class Noise(Derivative):
    """A function of the user that returns the spectral density of noise."""

    def check(self, value: Any, t: Any, _: Any = None) -> Array:
        """Return the value of the function as a C-ordered array, after checking it."""
        matrix = super().check(value, t)
        if fault := _fault(matrix):
            raise ValueError(f"noise must be {fault} at {time_text(t)}")
        return matrix

    def checked(self, t: float, y: Points, *arguments: Any) -> Array:
        """Return the density at a point; compiled code alone checks the shape only."""
        return self.check(self.function(t, y, *arguments), t)


def noise_of(noise: Any, problem: Problem) -> Noise | Array | None:
    """Return the spectral density of noise after checking it; a matrix is C-ordered.

    A compiled function is checked at the first point only, and not if it takes inputs.
    """
    frame, rhs = problem.plan.frame, problem.rhs
    if noise is None:
        return None
    if problem.direction < 0.0:
        raise ValueError(
            "noise must be None backward in time, where it would make variances negative, got "
            f"{noise!r} with t_span = {(problem.t0, problem.t1)!r}"
        )
    shape = frame.dim, frame.dim
    if not callable(noise) and compiled_rhs(noise, "noise") is None:
        return check_covariance(noise, frame.dim, None, "noise")
    function = derivative_of(noise, "noise", frame, shape, rhs.vectorized, rhs.extra.inputs, Noise)
    assert isinstance(function, Noise)
    if isinstance(function.function, CompiledRhs) and rhs.extra.inputs is None:
        arguments = rhs.extra.arguments(0)
        data = int(arguments[-1].ctypes.data) if rhs.extra.parameters is not None else 0
        data = data or (rhs.user_address if isinstance(rhs, CompiledRhs) else 0)
        function(problem.t0, problem.points[0], arguments, data)
    return function


def check_covariance(
    P0: ArrayLike | None, n: int, members: int | None, name: str = "P0"
) -> Array | None:
    """Return the covariance of initial coordinates, or one for each member, after checking it."""
    if P0 is None:
        return None
    matrix = real_array(P0, name)
    shapes = [(n, n)] if members is None else [(n, n), (members, n, n)]
    if matrix.shape not in shapes:
        raise ValueError(
            f"{name} must have shape {' or '.join(map(str, shapes))}, got {matrix.shape}"
        )
    check_finite(name, matrix)
    if fault := _fault(matrix):
        raise ValueError(f"{name} must be {fault}")
    return matrix


def _fault(matrix: Array) -> str:
    """Return why a matrix, or one of several, is no covariance; an empty text if all are."""
    sizes = np.abs(matrix).max(axis=(-2, -1))  # of each, which others may exceed by far
    if not (np.abs(matrix - matrix.mT).max(axis=(-2, -1)) <= _COVARIANCE_ERROR * sizes).all():
        return f"symmetric, got {matrix.tolist()}"
    eigenvalues = np.linalg.eigvalsh(matrix)
    if not (eigenvalues.min(axis=-1) >= -_COVARIANCE_ERROR * sizes).all():
        return f"positive semidefinite, got one with the eigenvalue {eigenvalues.min():.3g}"
    return ""
