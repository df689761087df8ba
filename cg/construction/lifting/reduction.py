"""Fewer flows of split rows, by merging them, and a smaller principal error.

A merge adds the weights of a flow to those of the flow before it, which changes the result little
where both are short, and solves again from there. The principal error, the norm of the residuals e
of the next order, is reduced along the solution set: with the kernel N of the conditions' Jacobian,
a step N w minimises ``|e + E N w|² + λ |w|²`` to first order (E the derivatives of e).
"""

import numpy as np
from scipy import linalg

from cg.construction.lifting.solver import Fit, fit
from cg.construction.lifting.split_rows import SplitRows
from cg.support.parallel import raise_if_stopped

_FIRST_ITERATIONS = 60  # most successful merges need fewer
_FIRST_PATIENCE = 12
_FURTHER_PATIENCE = 60
_FURTHER_SHARE = 4  # a quarter of the merges, the best ones, get more iterations
_MIN_FURTHER = 6

_GAP = 1e-9  # singular values below this fraction of the largest count as zero
_MAX_STEPS = 100
_MIN_GAIN = 1e-3  # decrease of the squared principal error, in one step
_MAX_TRIALS = 14
_CORRECTIONS = 40
_GROWTH = 1.25  # bound on weights, relative to the largest entry of the tableau


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
        kernel = linalg.null_space(split.jacobian(x), rcond=_GAP)
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
