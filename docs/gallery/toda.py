r"""Toda's lattice as an isospectral flow of symmetric matrices, with its exact solution [1]_, [2]_.

.. math:: L' = [\Omega(L), L], \qquad \Omega(L) = L_-^T - L_- ,

with the strictly lower triangle :math:`L_-`. The eigenvalues are constant; tridiagonal matrices
remain tridiagonal, and converge to the diagonal matrix of decreasing eigenvalues.

References
----------
.. [1] W. W. Symes, "The QR algorithm and scattering for the finite nonperiodic Toda lattice",
   Physica D 4 (1982), 275-280.
.. [2] M. P. Calvo, A. Iserles, A. Zanna, "Numerical solution of isospectral flows", Math. Comp. 66
   (1997), 1461-1486.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cg import solve_ivp
from cg.frames import IsospectralOrbit

Array = NDArray[np.float64]

y0 = np.array(
    [[1.0, 0.5, 0.0, 0.0], [0.5, -1.0, 0.75, 0.0], [0.0, 0.75, 0.5, 1.0], [0.0, 0.0, 1.0, 2.0]]
)
frame = IsospectralOrbit.through(y0)


def f(t: float, y: Array) -> Array:
    """Return the coefficients of the skew matrix, shape ``(..., n (n - 1) / 2)``."""
    lower = np.tril(y, -1)
    return frame.group.vee(lower.swapaxes(-2, -1) - lower)


def exact(t: float, start: Array = y0) -> Array:
    r"""Return the solution at a time, shape ``(n, n)``.

    It is :math:`Q^T L(0)\, Q` with :math:`e^{t L(0)} = Q R`, where R has a positive diagonal. Long
    times are divided into parts, so that the exponentials stay well conditioned.
    """
    parts = max(1, math.ceil(abs(t) * (frame.spectrum[-1] - frame.spectrum[0])))
    matrix = start
    for _ in range(parts):
        values, vectors = np.linalg.eigh(matrix)
        growth = np.exp(t / parts * (values - values.mean()))
        q, r = np.linalg.qr((vectors * growth) @ vectors.T)
        q = q * np.sign(np.diagonal(r))
        matrix = q.T @ matrix @ q
    return matrix


def invariants(y: Array) -> dict[str, Array]:
    """Return the eigenvalues, increasing, shape ``(..., n)``."""
    return {"eigenvalues": np.linalg.eigvalsh(y)}


if __name__ == "__main__":
    solution = solve_ivp(f, (0, 2), y0, frame=frame, rtol=1e-9, atol=1e-9)
    print("largest error of an entry:", abs(solution.y[-1] - exact(2.0)).max())
