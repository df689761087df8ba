"""Levenberg–Marquardt solver for split rows, with geodesic acceleration.

The unknowns are combinations u of the `directions` D of split rows, so that all x = x_0 + D u have
the rows of the flat tableau. A step v solves ``(Jᵀ J + λ) v = -Jᵀ r`` with J the derivatives of the
residuals r by u; see `cg.construction.solvers.damped`.

Some conditions are redundant, and there are more unknowns than the others determine, so that the
Jacobian is rank-deficient with a wide range of singular values. Steps come from the normal
equations far from a solution, and from the singular value decomposition close to one.

Derivatives take most of the time. If there are far more conditions than unknowns, steps use a
subset of the conditions: those that a pivoted QR factorisation of the Jacobian selects, and those
with the largest residuals. The subset is selected again when the other residuals stay large. All
conditions decide whether a fit has succeeded.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg.construction.lifting.split_rows import SplitRows
from cg.construction.solvers.damped import PROBE, DampedSteps, is_straight

Vector = NDArray[np.float64]

SOLVED = 1e-23
"""Sum of squared, scaled residuals below which weights are close to a solution."""

_CLOSE = 1e-10  # sum of squares below which steps come from the singular value decomposition
_MIN_DAMPING, _MAX_DAMPING = 1e-30, 1e8  # relative to the largest derivative
_MIN_GAIN = 1e-6
_MANY = 600  # number of conditions from which on a subset is used: that of order eight
_PIVOT = 1e-9  # smallest pivot of selected conditions, relative to the largest
_VIOLATED = 60  # number of conditions selected for their large residuals
_MAX_USES, _MIN_USES = 30, 4  # numbers of steps with one selection
_LEFT_BEHIND = 4.0  # ratio of the sums over all and selected conditions for a new selection


@dataclass(frozen=True)
class Fit:
    """Weights that add up to the rows, shape (size,), and the sum f of squared residuals."""

    x: Vector
    f: float

    @property
    def solved(self) -> bool:
        """Whether the residuals vanish to the accuracy of double precision."""
        return self.f < SOLVED


def fit(split: SplitRows, x: Vector, *, max_iterations: int, patience: int | None = None) -> Fit:
    """Solve from weights x, (size,), until `patience` steps don't halve the sum of squares."""
    directions = split.directions
    residual = split.residual(x)
    f = float(residual @ residual)
    if directions.shape[1] == 0:  # the rows determine all weights
        return Fit(x, f)
    damping, reached = 1e-2, [f]
    steps: DampedSteps | None = None
    chosen, taken = _select(split, x, residual), 0
    for _ in range(max_iterations):
        if not (f < np.inf and damping < _MAX_DAMPING):
            break
        close = f < _CLOSE
        if _is_outdated(chosen, taken, residual):
            chosen, taken, steps = _select(split, x, residual), 0, None
        if steps is None:
            steps = DampedSteps(split.jacobian(x, chosen), close)
        if not steps.damp(damping):
            damping *= 10
            continue
        now = residual[chosen]
        v = steps.step(now)
        moved = directions @ v
        a = steps.acceleration(v, now, split.residual(x + PROBE * moved)[chosen])
        trials = [x + moved + directions @ a / 2] * is_straight(v, a) + [x + moved] * close
        before_f = float(now @ now)
        best, residual, best_f = _best(split, (x, residual, before_f), trials, chosen)
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
    return Fit(x, f)


def _best(
    split: SplitRows,
    here: tuple[Vector, Vector, float],
    trials: list[Vector],
    chosen: NDArray[np.intp] | slice,
) -> tuple[Vector, Vector, float]:
    """Return the best weights, their residual, and the sum of squares of the chosen ones."""
    best = here
    for trial in trials:
        residual = split.residual(trial)
        part = residual[chosen]
        if part @ part < best[2]:
            best = trial, residual, float(part @ part)
    return best


def _select(split: SplitRows, x: Vector, residual: Vector) -> NDArray[np.intp] | slice:
    """Return the indices of the conditions to use in steps, or a slice for all of them."""
    if residual.size < _MANY:
        return slice(None)
    derivatives = split.jacobian(x).T
    pivots, order = linalg.qr(derivatives, mode="r", pivoting=True, check_finite=False)
    sizes = np.abs(np.diag(pivots))
    independent = order[: int(np.sum(sizes > _PIVOT * sizes[0]))]
    violated = np.argsort(-np.abs(residual), kind="stable")[:_VIOLATED]
    return np.union1d(independent, violated).astype(np.intp)


def _is_outdated(chosen: NDArray[np.intp] | slice, taken: int, residual: Vector) -> bool:
    """Return whether to select conditions again after a number of steps."""
    if isinstance(chosen, slice) or taken < _MIN_USES:
        return False
    part = residual[chosen]
    bound = _LEFT_BEHIND * float(part @ part) + SOLVED / _LEFT_BEHIND
    return taken >= _MAX_USES or float(residual @ residual) > bound
