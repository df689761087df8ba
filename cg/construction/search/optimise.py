"""Optimisation of methods along the solution set: Gauss–Newton on a manifold.

Each step solves a damped least-squares problem for the objective within the tangent space of the
set, then returns to the set by Newton steps of least norm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg.construction.conditions import core_calls
from cg.construction.search.candidate import Candidate, solved
from cg.construction.solvers.minimum_norm import decompose, retract
from cg.support.checks import check_instance, check_integer, check_real

_PENALTY = 30.0  # weight of what is beyond limits
_MAX_STEP = 1.0  # norm of a step; longer ones leave the reach of the tangent space
_TOLERANCE = 1e-4  # smallest relative decrease of the objective in eight iterations

Terms = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds on sums of unknowns, ``lower <= rows @ x <= upper``.

    Examples
    --------
    >>> import numpy as np
    >>> from cg.construction.search.optimise import Limits
    >>> Limits(np.array([[1.0, 1.0]]), 0.0, 1.0).beyond(np.array([0.5, 0.75]))[0]
    array([7.5])
    """

    rows: NDArray[np.float64]  # shape (m, size)
    lower: NDArray[np.float64] | float
    upper: NDArray[np.float64] | float

    def beyond(self, x: NDArray[np.float64]) -> Terms:
        """Return by how much sums are beyond their bounds, weighted, and the derivatives."""
        sums = self.rows @ x
        beyond = np.maximum(sums - self.upper, 0) + np.minimum(sums - self.lower, 0)
        return _PENALTY * beyond, _PENALTY * self.rows * (beyond != 0)[:, None]


def optimise(
    candidate: Candidate, *, principal_error: float = 1.0, coefficients: float = 0.0,
    limits: Limits | None = None, max_iterations: int = 60,
) -> Candidate:  # fmt: skip
    """Minimise a weighted sum of squares along the solution set.

    Parameters
    ----------
    candidate
        On the solution set.
    principal_error
        Weight of the norm of the residuals of order q + 1.
    coefficients
        Weight of the square root of ``Σ |x|^6``, which penalises the largest coefficients.
    limits
        Bounds on sums of coefficients; the amounts beyond them are penalised.
    max_iterations
        Largest number of iterations; also stops when eight together reduce the objective by less
        than a fraction of 1e-4.

    Returns
    -------
    Candidate
        A candidate on the solution set with an objective no larger than at the start.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> from cg.construction.search.optimise import optimise
    >>> from cg.construction.search.candidate import pack_method, to_method
    >>> candidate = pack_method(cg.methods["CF4b"])
    >>> smaller = optimise(candidate, principal_error=0, coefficients=1)
    >>> smaller.max_coefficient < 0.8 * candidate.max_coefficient
    True
    >>> to_method(smaller, name="CF4 small", source="CF4b, then along the solution set").order
    4
    """
    check_instance("candidate", candidate, Candidate)
    objective = partial(
        _objective,
        principal_error=check_real("principal_error", principal_error),
        coefficients=check_real("coefficients", coefficients),
        limits=limits,
    )
    max_iterations = check_integer("max_iterations", max_iterations, 0)
    if not solved(candidate):
        raise ValueError(
            f"candidate must be on the solution set, its sum of squares is {candidate.f:.2e}"
        )
    terms, damping = objective(candidate), 1e-2
    history = [float(terms[0] @ terms[0])]
    for _ in range(max_iterations):
        better = _better_candidate(candidate, objective, terms, damping)
        if better is None:
            break
        candidate, terms, damping = better
        damping = max(damping / 6, 1e-12)
        history.append(float(terms[0] @ terms[0]))
        if len(history) > 8 and history[-9] - history[-1] <= _TOLERANCE * history[-1]:
            break
    return candidate


def _better_candidate(
    candidate: Candidate, objective: Callable[[Candidate], Terms], terms: Terms, damping: float
) -> tuple[Candidate, Terms, float] | None:
    """Return a candidate with a smaller objective, its terms and its damping, or None."""
    movable, (values, jac) = candidate.system.movable, terms
    inverse, tangent = decompose(candidate.system.jacobian(candidate.x)[:, movable])
    if tangent.shape[1] == 0:
        return None
    along = jac[:, movable] @ tangent
    stretches, axes = linalg.eigh(along.T @ along)
    slope = axes.T @ (along.T @ values)
    scale = float(np.mean(stretches)) + np.finfo(float).tiny
    while damping < 1e8:
        step = -tangent @ (axes @ (slope / (stretches + damping * scale)))
        x = candidate.x.copy()
        x[movable] += step
        small = float(np.linalg.norm(step)) <= _MAX_STEP
        end = retract(candidate.system, x, movable, inverse) if small else None
        if end is not None:
            trial = Candidate(candidate.system, end)
            reached = objective(trial)
            if float(reached[0] @ reached[0]) < float(values @ values):
                return trial, reached, damping
        damping *= 4
    return None


def _objective(
    candidate: Candidate, principal_error: float, coefficients: float, limits: Limits | None
) -> Terms:
    """Return the terms whose squares `optimise` adds up, and their derivatives."""
    terms: list[Terms] = []
    x = candidate.x
    if principal_error:
        problem = candidate.next_order
        values, jac = core_calls.residuals(*problem), core_calls.jacobian(*problem)
        terms.append((principal_error * values, principal_error * jac))
    if coefficients:
        slopes = np.diag(3 * coefficients * x**2)
        terms.append((coefficients * np.abs(x) ** 3, slopes * np.sign(x)))
    if limits is not None:
        terms.append(limits.beyond(x))
    if not terms:
        raise ValueError("one of principal_error, coefficients and limits must be given")
    jac, held = np.concatenate([j for _, j in terms]), candidate.system.held
    return np.concatenate([v for v, _ in terms]), jac if held is None else held.derivatives(jac, x)
