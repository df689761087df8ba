"""Levenberg–Marquardt steps for splittings, with geodesic acceleration.

There are more conditions than count and more unknowns than those determine, so that the
derivatives have a wide range of singular values and a kernel. Far from a solution the normal
equations serve; close to one they would square the range and stall, and steps are made of
singular values instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .splitting import Splitting

__all__ = ["SOLVED", "Fit", "fit"]

Vector = NDArray[np.float64]

SOLVED = 1e-23
"""Sum of the squared, scaled residuals below which weights are next to a solution."""

_CLOSE = 1e-10  # the sum from which on steps are made of singular values
_PROBE = 0.1  # fraction of a step for the second derivative along it
_MOST_BEND = 0.75  # largest ratio of acceleration and step that is trusted far from a solution
_LEAST_DAMPING, _MOST_DAMPING = 1e-30, 1e8  # relative to the largest derivative
_LEAST_GAIN = 1e-6


@dataclass(frozen=True)
class Fit:
    """Where a fit ended.

    Attributes
    ----------
    x : ndarray, shape (size,)
        Weights, which add up to the rows.
    f : float
        Sum of the squared, scaled residuals.
    iterations : int
        Steps tried.
    """

    x: Vector
    f: float
    iterations: int

    @property
    def solved(self) -> bool:
        """Whether the residuals vanish as far as double precision can tell."""
        return self.f < SOLVED


def fit(
    splitting: Splitting, x: Vector, *, max_iterations: int, patience: int | None = None
) -> Fit:
    """Look for weights that satisfy the conditions, from a start.

    Parameters
    ----------
    splitting : Splitting
    x : ndarray, shape (size,)
        Adds up to the rows.
    max_iterations : int
    patience : int, optional
        Stop where so many steps have not halved the sum.

    Returns
    -------
    Fit
    """
    directions = splitting.directions
    residual = splitting.residual(x)
    f = float(residual @ residual)
    if directions.shape[1] == 0:  # the rows leave nothing to choose
        return Fit(x, f, 0)
    damping, iterations = 1e-2, 0
    steps: _Steps | None = None
    reached = [f]
    while iterations < max_iterations and f < np.inf and damping < _MOST_DAMPING:
        iterations += 1
        close = f < _CLOSE
        if steps is None:
            steps = _Steps(splitting.jacobian(x), close)
        if not steps.damp(damping):
            damping *= 10
            continue
        v = steps.step(residual)
        moved = directions @ v
        ahead = splitting.residual(x + _PROBE * moved)
        a = steps.step(2 / _PROBE * ((ahead - residual) / _PROBE - steps.jacobian @ v))
        straight = np.linalg.norm(a) <= _MOST_BEND * np.linalg.norm(v)
        trials = [x + moved + directions @ a / 2] if straight else []
        if close:
            trials.append(x + moved)
        best, best_f = x, f
        for trial in trials:
            trial_residual = splitting.residual(trial)
            if trial_residual @ trial_residual < best_f:
                best, residual = trial, trial_residual
                best_f = float(residual @ residual)
        gain = 1 - best_f / f if f else 0.0
        if f < SOLVED and gain < _LEAST_GAIN:
            break
        if best_f < f:
            x, f, steps = best, best_f, None
            damping = max(damping / 5, _LEAST_DAMPING)
        else:
            damping = 3 * max(damping, 1e-20)
        reached.append(f)
        before = reached[-1 - patience] if patience and len(reached) > patience else np.inf
        if f > max(SOLVED, before / 2):
            break
    return Fit(x, f, iterations)


class _Steps:
    """Damped steps at one point: solutions of ``(Jᵀ J + λ) p = -Jᵀ r``."""

    def __init__(self, jacobian: Vector, close: bool) -> None:
        self.jacobian = jacobian
        self._close = close
        if close:
            self._left, self._values, self._right = linalg.svd(
                jacobian, full_matrices=False, check_finite=False
            )
            self._size = float(self._values[0]) ** 2
        else:
            self._gram = jacobian.T @ jacobian
            self._size = float(np.max(np.diag(self._gram)))

    def damp(self, damping: float) -> bool:
        """Set λ, relative to the largest derivative; tell whether that is regular."""
        if self._close:
            self._factors = self._values / (self._values**2 + damping * self._size)
            return True
        shifted = self._gram + damping * self._size * np.eye(len(self._gram))
        try:
            self._cholesky = linalg.cho_factor(shifted, check_finite=False)
        except linalg.LinAlgError:
            return False
        return True

    def step(self, residual: Vector) -> Vector:
        """Return p."""
        if self._close:
            return np.asarray(-self._right.T @ (self._factors * (self._left.T @ residual)))
        right = -self.jacobian.T @ residual
        return np.asarray(linalg.cho_solve(self._cholesky, right, check_finite=False))
