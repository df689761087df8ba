"""Observed orders from errors at several step sizes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.integration.ivp import integrate
from cg.integration.rhs.function import Function
from cg.support.arrays import Array, check_positive, vectors_of_one_length
from cg.tables import HasTable


def observed_order(h: ArrayLike, errors: ArrayLike, *, floor: float = 0.0) -> float:
    """Return the least-squares slope of log error against log step size.

    Errors at or below `floor` count as rounding errors.
    """
    steps, sizes = vectors_of_one_length("h", h, errors)
    used = ~(sizes <= floor)  # the negated comparison keeps NaN, which is refused below
    if used.sum() < 2:
        raise ValueError(
            f"errors must leave two points above floor = {floor:g}, got errors = {sizes}"
        )
    steps, sizes = steps[used], sizes[used]
    check_positive("h", steps)
    check_positive("errors", sizes)
    if len(np.unique(steps)) < len(steps):
        raise ValueError(f"h must be distinct, got {steps}")
    return float(np.polyfit(np.log(steps), np.log(sizes), 1)[0])


def final_errors(
    f: Function, t_span: tuple[float, float], y0: ArrayLike, exact: ArrayLike, *, frame: Frame,
    method: str | HasTable, h: Sequence[float],
) -> Array:  # fmt: skip
    """Return the distances of integrations with constant steps `h` from the exact end."""
    runs = (integrate(f, t_span, y0, frame=frame, method=method, h=size) for size in h)
    return np.array([float(frame.distance(run.y[-1], exact)) for run in runs])
