"""Levenberg–Marquardt steps with geodesic acceleration, for any residual function.

A damped step v solves ``(Jᵀ J + λ) v = -Jᵀ r``. The acceleration a solves the same system with the
second derivative of the residual along v in place of r; the accelerated step is ``v + a/2`` [1]_.

Far from a solution the normal equations are fast and accurate enough. Close to one, where the
singular values of J have a wide range, they square that range and stall; steps are then computed
from the singular value decomposition.

References
----------
.. [1] M. K. Transtrum, J. P. Sethna, "Improvements to the Levenberg-Marquardt algorithm for
   nonlinear least-squares minimization", arXiv:1201.5885 (2012).
"""

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Vector = NDArray[np.float64]

PROBE = 0.1
"""Fraction of a step used for the finite difference of the second derivative along it."""

_MAX_BEND = 0.75  # largest ratio |a| / |v| at which the acceleration is trusted


class DampedSteps:
    """Damped steps from a point with a Jacobian (m, n), by normal equations or an SVD."""

    def __init__(self, jacobian: Vector, by_singular_values: bool) -> None:
        self.jacobian = jacobian
        self._by_singular_values = by_singular_values
        if by_singular_values:
            self._left, self._values, self._right = linalg.svd(
                jacobian, full_matrices=False, check_finite=False
            )
            self._largest = float(self._values[0]) ** 2
        else:
            self._gram = jacobian.T @ jacobian
            self._largest = float(np.max(np.diag(self._gram)))

    def damp(self, damping: float) -> bool:
        """Set λ relative to the largest entry of Jᵀ J; return whether the system is regular."""
        if self._by_singular_values:
            self._factors = self._values / (self._values**2 + damping * self._largest)
            return True
        shifted = self._gram + damping * self._largest * np.eye(len(self._gram))
        try:
            self._cholesky = linalg.cho_factor(shifted, check_finite=False)
        except linalg.LinAlgError:
            return False
        return True

    def step(self, residual: Vector) -> Vector:
        """Return the damped step v for a residual r; shapes (n,) and (m,)."""
        if self._by_singular_values:
            return np.asarray(-self._right.T @ (self._factors * (self._left.T @ residual)))
        right = -self.jacobian.T @ residual
        return np.asarray(linalg.cho_solve(self._cholesky, right, check_finite=False))

    def acceleration(self, v: Vector, residual: Vector, residual_ahead: Vector) -> Vector:
        """Return the acceleration of a step v; `residual_ahead` is that after `PROBE` times v."""
        slope = (residual_ahead - residual) / PROBE
        return self.step(2 / PROBE * (slope - self.jacobian @ v))


def is_straight(v: Vector, a: Vector) -> bool:
    """Return whether the acceleration is small enough to be trusted."""
    return bool(np.linalg.norm(a) <= _MAX_BEND * np.linalg.norm(v))
