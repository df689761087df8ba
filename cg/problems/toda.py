"""Toda's lattice as an isospectral flow, with its exact solution by a QR factorisation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from cg.frames import IsospectralOrbit
from cg.frames.arrays import Array, real_array
from cg.problems.checks import times_array


@dataclass(frozen=True, eq=False)
class TodaFlow:
    r"""Toda's flow of a symmetric matrix.

    .. math:: L' = [\Omega(L), L], \qquad \Omega(L) = L_-^T - L_- ,

    with the strictly lower triangle :math:`L_-`.  The eigenvalues are constant; tridiagonal
    matrices remain tridiagonal, and converge to the diagonal matrix of decreasing eigenvalues.

    A point is the matrix :math:`L`.

    Parameters
    ----------
    initial
        The matrix at time zero: symmetric, shape ``(n, n)``.

    Raises
    ------
    ValueError
        If ``initial`` isn't a real symmetric finite matrix of at least two rows.

    References
    ----------
    .. [1] W. W. Symes, "The QR algorithm and scattering for the finite nonperiodic Toda lattice",
       Physica D 4 (1982), 275-280.
    .. [2] M. P. Calvo, A. Iserles, A. Zanna, "Numerical solution of isospectral flows", Math.
       Comp. 66 (1997), 1461-1486.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> problem = TodaFlow()
    >>> run = cg.integrate(problem.f, (0, 2), problem.y0, frame=problem.frame, method="CF4", h=0.02)
    >>> np.allclose(run.y[-1], problem.exact(2.0), atol=1e-6)
    True
    >>> eigenvalues = problem.invariants(run.y)["eigenvalues"]
    >>> np.allclose(eigenvalues, eigenvalues[0], rtol=0, atol=1e-13)
    True
    """

    initial: ArrayLike = ((1.0, 0.5, 0.0, 0.0), (0.5, -1.0, 0.75, 0.0),
                          (0.0, 0.75, 0.5, 1.0), (0.0, 0.0, 1.0, 2.0))  # fmt: skip
    _frame: IsospectralOrbit = field(init=False, repr=False)

    def __post_init__(self) -> None:
        matrix = real_array(self.initial, "initial")
        try:
            frame = IsospectralOrbit.through(matrix)
        except ValueError as error:
            raise ValueError(
                f"initial must be a finite symmetric matrix, got {self.initial!r}"
            ) from error
        matrix.flags.writeable = False
        object.__setattr__(self, "initial", matrix)
        object.__setattr__(self, "_frame", frame)

    @property
    def frame(self) -> IsospectralOrbit:
        """The orbit of the initial matrix."""
        return self._frame

    @property
    def y0(self) -> Array:
        """The initial matrix, shape ``(n, n)``."""
        return np.asarray(self.initial)

    def f(self, t: float, y: Array) -> Array:
        """Return the coefficients of the skew matrix, shape ``(..., n (n - 1) / 2)``."""
        lower = np.tril(y, -1)
        return self.frame.group.coefficients(lower.swapaxes(-2, -1) - lower)

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return the eigenvalues, increasing, shape ``(..., n)``."""
        points = self.frame._points(y)
        if not np.isfinite(points).all():
            raise ValueError(f"y must be finite, got {points}")
        return {"eigenvalues": np.linalg.eigvalsh(points)}

    def exact(self, t: ArrayLike) -> Array:
        r"""Return the solution at given times, shape ``(..., n, n)``.

        It is :math:`Q^T L(0)\, Q` with :math:`e^{t L(0)} = Q R`, where R has a positive
        diagonal.  Long times are divided into parts, so that the exponentials stay well
        conditioned.
        """
        times = times_array(t)
        largest = _MAX_PARTS / max(1.0, self.frame.spectrum[-1] - self.frame.spectrum[0])
        if times.size and np.abs(times).max() > largest:
            raise ValueError(f"t must be at most {largest:.3g}, got {t!r}")
        spread = self.frame.spectrum[-1] - self.frame.spectrum[0]
        solution = np.empty((*times.shape, *self.y0.shape))
        for index, time in np.ndenumerate(times):
            parts = max(1, math.ceil(abs(time) * spread))
            matrix = self.y0
            for _ in range(parts):
                matrix = _advance(matrix, time / parts)
            solution[index] = matrix
        return solution


_MAX_PARTS = 100_000


def _advance(matrix: Array, t: float) -> Array:
    """Return the solution after the time t, by one QR factorisation."""
    values, vectors = np.linalg.eigh(matrix)
    q, r = np.linalg.qr((vectors * np.exp(t * (values - values.mean()))) @ vectors.T)
    q = q * np.sign(np.diagonal(r))
    return np.asarray(q.T @ matrix @ q)
