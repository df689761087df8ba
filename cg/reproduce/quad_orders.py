"""Errors of the spinning top in real(16), and their slopes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import Any

from cg.analysis.convergence import observed_order, slopes
from cg.runs.execution import as_finished

from . import fingerprint, top
from .checkpoint import Checkpoint
from .context import Context

__all__ = ["FIT", "Run", "end_errors", "order_data"]

FIT = 4
"""Number of points, those with the smallest steps, to which a slope is fitted."""

Run = tuple[top.Reading, str, int]
"""An integration over [0, 1]: reading, method, number of steps."""


def end_errors(context: Context, runs: Sequence[Run]) -> dict[Run, float]:
    """Integrate in real(16), several at a time, and return the errors of B at t = 1.

    Errors are stored in a checkpoint, and are not computed again.

    Parameters
    ----------
    context : Context
    runs : sequence of Run
        Long runs should be first, so that all cores are busy until the end.
    """
    digest = fingerprint.of_code(__name__, {})
    checkpoint = Checkpoint(context.checkpoints / f"quad-errors-{digest}.jsonl", _recorded)
    try:
        errors = dict(checkpoint.records)
        missing = [run for run in runs if run not in errors]
        for reading in {run[0] for run in missing}:
            top.reference_end(reading)  # once, before threads ask for it
        with closing(as_finished(partial(_indexed_error, missing), range(len(missing)),
                                 context.workers)) as running:  # fmt: skip
            for index, error in running:
                errors[missing[index]] = error
                checkpoint.append({"run": missing[index], "error": error})
                context.progress(sum(run in errors for run in runs), len(runs))
    finally:
        checkpoint.close()
    return {run: errors[run] for run in runs}


def _recorded(record: Any) -> tuple[Run, float]:
    """Read a record of the checkpoint."""
    try:
        reading, method, steps = record["run"]
        error = record["error"]
        if not (isinstance(error, float) and 0 < error < math.inf):
            raise TypeError
    except (IndexError, KeyError, TypeError, ValueError):
        raise ValueError(f"not the record of an error: {str(record)[:80]}") from None
    return (reading, method, steps), error


def _indexed_error(runs: Sequence[Run], index: int) -> tuple[int, float]:
    reading, method, steps = runs[index]
    return index, top.end_error(reading, method, steps, "real128")[0]


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
