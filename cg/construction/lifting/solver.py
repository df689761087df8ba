"""Levenberg–Marquardt steps for splittings, with geodesic acceleration.

There are more conditions than count and more unknowns than those determine, so that the
derivatives have a wide range of singular values and a kernel. Far from a solution the normal
equations serve; close to one they would square the range and stall, and steps are made of
singular values instead.

Derivatives take most of the time. Where there are far more conditions than unknowns, steps are
made with some of the conditions, those that a pivoted QR factorisation of the derivatives chooses
and those that are violated most; they are chosen again when the others don't follow. All conditions
decide whether a fit has succeeded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from ..solvers.damped import PROBE, DampedSteps, is_straight
from .splitting import Splitting

__all__ = ["SOLVED", "Fit", "fit"]

Vector = NDArray[np.float64]

SOLVED = 1e-23
"""Sum of the squared, scaled residuals below which weights are next to a solution."""

_CLOSE = 1e-10  # the sum from which on steps are made of singular values
_MIN_DAMPING, _MAX_DAMPING = 1e-30, 1e8  # relative to the largest derivative
_MIN_GAIN = 1e-6
_MANY = 600  # conditions from which on some are chosen: those of order eight
_COUNT = 1e-9  # of the largest: pivots of conditions that are chosen
_VIOLATED = 60  # conditions that are chosen since they are violated most
_CHOSEN_FOR = 30  # steps
_LEFT_BEHIND = 4.0  # times the sum over the chosen: the whole sum at which they are chosen again
_MIN_CHOSEN_FOR = 4


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
    steps: DampedSteps | None = None
    reached = [f]
    chosen, taken = _chosen(splitting, x, residual), 0
    while iterations < max_iterations and f < np.inf and damping < _MAX_DAMPING:
        iterations += 1
        close = f < _CLOSE
        if _outdated(chosen, taken, residual):
            chosen, taken, steps = _chosen(splitting, x, residual), 0, None
        if steps is None:
            steps = DampedSteps(splitting.jacobian(x, chosen), close)
        if not steps.damp(damping):
            damping *= 10
            continue
        now = residual[chosen]
        v = steps.step(now)
        moved = directions @ v
        a = steps.acceleration(v, now, splitting.residual(x + PROBE * moved)[chosen])
        trials = [x + moved + directions @ a / 2] if is_straight(v, a) else []
        if close:
            trials.append(x + moved)
        before_f = best_f = float(now @ now)
        best = x
        for trial in trials:
            trial_residual = splitting.residual(trial)
            part = trial_residual[chosen]
            if part @ part < best_f:
                best, residual = trial, trial_residual
                best_f = float(part @ part)
        gain = 1 - best_f / before_f if before_f else 0.0
        if f < SOLVED and gain < _MIN_GAIN:
            break
        if best_f < before_f:
            x, f, steps = best, float(residual @ residual), None
            taken += 1
            damping = max(damping / 5, _MIN_DAMPING)
        else:
            damping = 3 * max(damping, 1e-20)
        reached.append(f)
        before = reached[-1 - patience] if patience and len(reached) > patience else np.inf
        if f > max(SOLVED, before / 2):
            break
    return Fit(x, f, iterations)


def _chosen(splitting: Splitting, x: Vector, residual: Vector) -> NDArray[np.intp] | slice:
    """Return which conditions steps are made with: indices, or all of them."""
    if residual.size < _MANY:
        return slice(None)
    derivatives = splitting.jacobian(x).T
    pivots, order = linalg.qr(derivatives, mode="r", pivoting=True, check_finite=False)
    sizes = np.abs(np.diag(pivots))
    counting = order[: int(np.sum(sizes > _COUNT * sizes[0]))]
    violated = np.argsort(-np.abs(residual), kind="stable")[:_VIOLATED]
    return np.union1d(counting, violated).astype(np.intp)


def _outdated(chosen: NDArray[np.intp] | slice, taken: int, residual: Vector) -> bool:
    """Tell whether conditions are to be chosen again after so many steps."""
    if isinstance(chosen, slice) or taken < _MIN_CHOSEN_FOR:
        return False
    part = residual[chosen]
    bound = _LEFT_BEHIND * float(part @ part) + SOLVED / _LEFT_BEHIND
    return taken >= _CHOSEN_FOR or float(residual @ residual) > bound
