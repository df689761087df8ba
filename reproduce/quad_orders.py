"""Errors of the spinning top in real(16) and their slopes, for all figures that show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from cg.convergence import observed_order, slopes

from . import top
from .context import Context

__all__ = ["FIT", "Run", "end_errors", "order_data"]

FIT = 4
"""Points, those with the smallest steps, that a slope is fitted to."""

Run = tuple[top.Reading, str, int]
"""An integration over [0, 1]: reading, method, number of steps."""


def end_errors(context: Context, runs: Sequence[Run]) -> dict[Run, float]:
    """Integrate in real(16), several at a time, and return the errors of B at t = 1.

    Parameters
    ----------
    context : Context
    runs : sequence of Run
        Best with the longest first, so that no core waits at the end.
    """
    for reading in {run[0] for run in runs}:
        top.reference_end(reading)  # once, before threads ask for it
    errors = {}
    with ThreadPoolExecutor(context.workers) as pool:
        try:
            found = pool.map(_error, runs)
            for done, (run, error) in enumerate(zip(runs, found, strict=True)):
                errors[run] = error
                context.progress(done + 1, len(runs))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return errors


def _error(run: Run) -> float:
    reading, method, steps = run
    return top.end_error(reading, method, steps, "real128")[0]


def order_data(errors: Mapping[int, float]) -> dict[str, object]:
    """Return what errors by number of steps say about the order.

    Returns
    -------
    dict
        ``h``, from the largest; ``error``; ``local`` slopes between neighbours; ``slope`` fitted
        over the smallest `FIT` stepsizes; ``largest_slope`` over all local ones.
    """
    steps = sorted(errors)
    h, error = [1 / n for n in steps], [errors[n] for n in steps]
    local = slopes(h, error).tolist()
    return {
        "h": h,
        "error": error,
        "local": local,
        "slope": observed_order(h[-FIT:], error[-FIT:]).order,
        "largest_slope": max(local),
    }
