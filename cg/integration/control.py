"""The step size control of an integration."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cg.support.arrays import Array


class Control(NamedTuple):
    """The step size control.

    The defaults are those of equal steps: a collocation method scales the corrections of Newton's
    method by the tolerances.
    """

    h: float | None  # size of equal steps, None for adaptive steps
    rtol: Array = np.array([1e-3])  # as many as atol
    atol: Array = np.array([1e-6])
    max_step: float = math.inf
    first_step: float | None = None
    max_steps: int = 10**6  # rejected ones included

    @property
    def tolerance(self) -> float | None:
        """The least relative tolerance, None for equal steps."""
        return None if self.h is not None else float(np.min(self.rtol))
