"""Reduction of the number of flows of a splitting by merging them."""

from __future__ import annotations

from ...support.parallel import raise_if_stopped
from .solver import Fit, fit
from .splitting import Splitting

__all__ = ["reduced"]

_FIRST_ITERATIONS = 60  # most successful merges need fewer
_FIRST_PATIENCE = 12
_FURTHER_PATIENCE = 60
_FURTHER_SHARE = 4  # one of so many merges gets more iterations
_MIN_FURTHER = 6


def reduced(splitting: Splitting, end: Fit, max_iterations: int) -> tuple[Splitting, Fit]:
    """Merge flows with the flows before them until no merge leads to a solution.

    `max_iterations` is for merges that nearly led to a solution. Returns the last solution.
    """
    while True:
        merged = _merged(splitting, end, max_iterations)
        if merged is None:
            return splitting, end
        splitting, end = merged


def _merged(splitting: Splitting, end: Fit, max_iterations: int) -> tuple[Splitting, Fit] | None:
    """Return the first merge that leads to a solution; merges with small residuals come first."""
    merges = []
    for point in range(len(splitting.layout.parents)):
        merge = splitting.merged(end.x, point)
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
