"""Errors of the spinning top in quadruple precision, and their slopes."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np

from cg.construction.catalogue import methods
from cg.problems.convergence import observed_order
from cg.support.parallel import completed

from . import top
from .blocks import Context

FIT = 4
"""Number of points, those with the smallest steps, to which a slope is fitted."""

Run = tuple[top.Reading, str, int]
"""An integration over [0, 1]: reading, method, number of steps."""


def convergence(context: Context, steps: Mapping[str, Iterable[int]]) -> dict[str, dict[str, Any]]:
    """Integrate in quadruple precision with several stepsizes, several runs at a time.

    `steps` has the numbers of steps by method. Both readings of the initial momentum are used in an
    extensive run, else the first. Returns by reading the ``reference_error`` at t = 1, and
    ``methods``: by method `order_data` of the errors of B at t = 1.
    """
    full = context.settings.full
    readings: tuple[top.Reading, ...] = ("momentum", "velocity") if full else ("momentum",)
    runs: list[Run] = [(r, name, n) for r in readings for name, ns in steps.items() for n in ns]
    runs.sort(key=lambda run: -run[2])  # long runs first, so that no core waits at the end
    # nearly all the time goes into flows
    work = [n * methods[name].exponentials for _, name, n in runs]
    done = 0
    context.report_work(done, sum(work))
    errors: dict[Run, float] = {}
    executor = "processes" if context.workers > 1 else None
    results = completed(partial(_error, runs), range(len(runs)), executor, context.workers)
    with closing(results) as running:
        for index, error in running:
            errors[runs[index]] = error
            done += work[index]
            context.report_work(done, sum(work))
    return {
        reading: {
            "reference_error": top.reference_end(reading)[1],
            "methods": {
                name: order_data({n: errors[reading, name, n] for n in ns})
                for name, ns in steps.items()
            },
        }
        for reading in readings
    }


def _error(runs: Sequence[Run], index: int) -> float:
    return top.quad_end_error(*runs[index])


def order_data(errors: Mapping[int, float]) -> dict[str, object]:
    """Return the order that errors by number of steps show.

    The keys are ``h``, from the largest; ``error``; ``local`` slopes between neighbours; ``slope``
    fitted over the smallest `FIT` stepsizes; ``largest_slope`` over all local ones.
    """
    h, error = map(list, zip(*((1 / n, errors[n]) for n in sorted(errors)), strict=True))
    local = (np.diff(np.log(error)) / np.diff(np.log(h))).tolist()
    return {
        "h": h,
        "error": error,
        "local": local,
        "slope": observed_order(h[-FIT:], error[-FIT:]),
        "largest_slope": max(local),
    }
