"""Levenberg–Marquardt solver for split rows, with geodesic acceleration.

The unknowns are combinations u of the `directions` D of split rows, so that all x = x_0 + D u have
the rows of the flat tableau. A step v solves ``(Jᵀ J + λ) v = -Jᵀ r`` with J the derivatives of the
residuals r by u; see `cg.construction.solvers.minimum_norm`.

Some conditions are redundant, and there are more unknowns than the others determine, so that the
Jacobian is rank-deficient with a wide range of singular values. Steps come from the normal
equations far from a solution, and from the singular value decomposition close to one.

Flows are merged: the weights of a flow are added to those of the flow before it, which changes the
result little where both are short, and the fit starts again from there. The principal error, the
norm of the residuals e of the next order, is reduced along the solution set: with the kernel N of
the conditions' Jacobian, a step N w minimises ``|e + E N w|² + λ |w|²`` to first order (E the
derivatives of e).

Weights are refined beyond double precision by Newton's method in fractions (`refine_rational`) with
the midpoints of balls as residuals: trees of order eight have too many words for exact fractions,
whose lengths grow with the order.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg.construction.conditions.exact import (
    Quantity,
    Weights,
    condition_words,
    nodes,
    reciprocal_density,
)
from cg.construction.lifting.split_rows import SplitRows
from cg.construction.solvers.minimum_norm import PROBE, DampedSteps, is_straight, pseudo_inverse
from cg.construction.solvers.refine import refine_rational
from cg.support.parallel import raise_if_stopped
from cg.support.quads import DECIMAL_DIGITS, exact_midpoint, to_ball, to_decimal, working_precision

Vector = NDArray[np.float64]

SOLVED = 1e-23
"""Sum of squared, scaled residuals below which weights are close to a solution."""

_CLOSE = 1e-10  # sum of squares below which steps come from the singular value decomposition
_MIN_DAMPING, _MAX_DAMPING = 1e-30, 1e8  # relative to the largest derivative

_FIRST_ITERATIONS = 60  # most successful merges need fewer
_FIRST_PATIENCE = 12
_FURTHER_PATIENCE = 60
_FURTHER_SHARE = 4  # a quarter of the merges, the best ones, get more iterations
_MIN_FURTHER = 6

_KERNEL_GAP = 1e-9  # singular values below this fraction of the largest count as zero
_MAX_STEPS = 100
_MIN_GAIN = 1e-3  # decrease of the sum of squares, or of the squared principal error, in one step
_MAX_TRIALS = 14
_CORRECTIONS = 40
_GROWTH = 1.25  # bound on weights, relative to the largest entry of the tableau

_BITS = 400
_GRID = 10**80
_RESIDUAL_GOAL = Fraction(1, 10**60)
_NEAR_RATIONAL, _MAX_DENOMINATOR = Fraction(1, 10**40), 10**5  # limits for rational numbers
_RANK_GAP = 1e-10  # singular values that count as zero in the refinement, likewise


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
    for _ in range(max_iterations):
        if not (f < np.inf and damping < _MAX_DAMPING):
            break
        close = f < _CLOSE
        if steps is None:
            steps = DampedSteps(split.jacobian(x), close)
        if not steps.damp(damping):
            damping *= 10
            continue
        v = steps.step(residual)
        moved = directions @ v
        a = steps.acceleration(v, residual, split.residual(x + PROBE * moved))
        best, best_residual, best_f = x, residual, f
        for trial in [x + moved + directions @ a / 2] * is_straight(v, a) + [x + moved] * close:
            trial_residual = split.residual(trial)
            trial_f = float(trial_residual @ trial_residual)
            if trial_f < best_f:
                best, best_residual, best_f = trial, trial_residual, trial_f
        gain = 1 - best_f / f if f else 0.0
        if f < SOLVED and gain < _MIN_GAIN:
            break
        if best_f < f:
            x, residual, f, steps = best, best_residual, best_f, None
            damping = max(damping / 5, _MIN_DAMPING)
        else:
            damping = 3 * max(damping, 1e-20)
        reached.append(f)
        before = reached[-1 - patience] if patience and len(reached) > patience else np.inf
        if f > max(SOLVED, before / 2):
            break
    return Fit(x, f)


def merged_flows(split: SplitRows, end: Fit, max_iterations: int) -> tuple[SplitRows, Fit]:
    """Merge flows with those before them until no merge leads to a solution; return the last."""
    while True:
        merged = _merged(split, end, max_iterations)
        if merged is None:
            return split, end
        split, end = merged


def _merged(split: SplitRows, end: Fit, max_iterations: int) -> tuple[SplitRows, Fit] | None:
    """Return the first merge that leads to a solution; merges with small residuals come first."""
    merges = []
    for point in range(len(split.layout.parents)):
        merge = split.merged(end.x, point)
        if merge is not None:
            violated = merge[0].residual(merge[1])
            merges.append((float(violated @ violated), point, *merge))
    left = []
    for _, point, merged, start in sorted(merges, key=lambda entry: entry[:2]):
        raise_if_stopped()
        attempt = fit(
            merged, start, max_iterations=min(_FIRST_ITERATIONS, max_iterations),
            patience=_FIRST_PATIENCE,
        )  # fmt: skip
        if attempt.solved:
            return merged, attempt
        left.append((attempt.f, point, merged, attempt))
    left.sort(key=lambda entry: entry[:2])
    for _, _, merged, attempt in left[: max(_MIN_FURTHER, len(left) // _FURTHER_SHARE)]:
        raise_if_stopped()
        again = fit(merged, attempt.x, max_iterations=max_iterations, patience=_FURTHER_PATIENCE)
        if again.solved:
            return merged, again
    return None


def improved(split: SplitRows, end: Fit) -> Fit:
    """Reduce the principal error of a solution along the solution set until it hardly gets smaller.

    Levenberg–Marquardt steps for the residuals of the next order in the tangent space; a fit then
    returns to the set. Weights don't grow beyond 1.25 times the largest entry of the tableau.
    """
    x = end.x
    rows = [*split.rows.stages, split.rows.result]
    largest = float(max(abs(entry) for row in rows for entry in row))
    most = max(float(np.max(np.abs(x))), _GROWTH * largest)
    residual = split.principal_residual(x)
    error, damping = float(residual @ residual), 1e-3
    for _ in range(_MAX_STEPS):
        raise_if_stopped()
        kernel = linalg.null_space(split.jacobian(x), rcond=_KERNEL_GAP)
        moves = split.directions @ kernel  # they change no condition to first order
        if moves.shape[1] == 0:
            break
        jacobian = split.principal_jacobian(x) @ moves
        gram, slope = jacobian.T @ jacobian, jacobian.T @ residual
        size = float(np.max(np.diag(gram)))
        for _ in range(_MAX_TRIALS):
            shifted = gram + damping * size * np.eye(len(gram))
            step = moves @ linalg.solve(shifted, -slope, assume_a="pos")
            trial = fit(split, x + step, max_iterations=_CORRECTIONS)
            within = trial.solved and np.max(np.abs(trial.x)) <= most
            residual = split.principal_residual(trial.x) if within else residual
            if within and residual @ residual < error:
                break
            damping *= 4
        else:
            break
        gain = 1 - float(residual @ residual) / error
        end, x, error = trial, trial.x, float(residual @ residual)
        damping /= 5
        if gain < _MIN_GAIN:
            break
    return end


def refined(split: SplitRows, x: Vector) -> tuple[list[str | Fraction], float, int]:
    """Refine weights x, shape (size,), to more digits than are written.

    Returns weights whose sums are exact, the residual before rounding to 36 digits, and the rank.
    """
    # the pseudo-inverse is in orthonormal directions, the unknowns are entries themselves
    along, rank = pseudo_inverse(split.jacobian(x), _RANK_GAP)
    inverse = split.directions[split.movable] @ along * split.scale
    end = refine_rational(
        lambda movable: _ball_residuals(split, movable),
        [Fraction(value) for value in x[split.movable].tolist()],
        inverse,
        below=_RESIDUAL_GOAL,
        grid=_GRID,
    )
    texts = list(map(_text, end.x))
    weights: list[str | Fraction] = list(split.full([Fraction(text) for text in texts]))
    for k, text in zip(split.movable.tolist(), texts, strict=True):
        weights[k] = text
    return weights, float(end.largest_residual), rank


def _text(value: Fraction) -> str:
    """Return a value as a decimal, or as the rational number that it is to all digits."""
    simple = value.limit_denominator(_MAX_DENOMINATOR)
    return (
        str(simple) if abs(value - simple) <= _NEAR_RATIONAL else to_decimal(value, DECIMAL_DIGITS)
    )


def _ball_residuals(split: SplitRows, movable: Sequence[Fraction]) -> list[Fraction]:
    """Return the residuals, not scaled, in the order of `SplitRows.conditions`."""
    layout, x = split.layout, split.full(movable)
    claims = [(layout.stages, split.order, Fraction(1))]
    if split.embedded_order:
        claims.append((layout.stages + 1, split.embedded_order, Fraction(1)))
    for stage, order in split.assumptions:
        claims.append((stage, order, sum((x[k] for k in layout.row(stage)), Fraction(0))))
    quantities, sides = [], []
    for row, order, c in claims:
        for word in condition_words(order):
            quantities.append(Quantity(row, word))
            sides.append(reciprocal_density(word) * c ** nodes(word))
    with working_precision(_BITS):
        weights = Weights(layout, quantities).evaluate(list(map(to_ball, x)))
        return [
            exact_midpoint(phi - to_ball(side)) for phi, side in zip(weights, sides, strict=True)
        ]
