"""Constants of collocation methods, whose stages compiled code solves together."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.support.arrays import Array


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
