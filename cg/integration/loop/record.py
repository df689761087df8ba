"""What Python passes to a run of compiled code: its record, step size control and output."""

from __future__ import annotations

import ctypes
import math
from typing import NamedTuple

import numpy as np

from cg.support.arrays import Array
from cg.support.shared_records import COUNTERS, RECORD, fields_of

COUNTS = tuple(COUNTERS)[2:]
"""Counts of each member, in the order of compiled code."""


class Record(ctypes.Structure):
    """The record that compiled code reads and writes."""

    _fields_ = fields_of(RECORD)


class Control(NamedTuple):
    """The step size control.

    The defaults are those of equal steps: a collocation method scales the corrections of Newton's
    method by the tolerances.
    """

    h: float | None  # size of equal steps, None for adaptive steps
    rtol: Array = np.array([1e-3])  # of the shape of atol
    atol: Array = np.array([1e-6])
    max_step: float = math.inf
    first_step: float | None = None
    max_steps: int = 10**6  # rejected ones included

    @property
    def tolerance(self) -> float | None:
        """The least relative tolerance, None for equal steps."""
        return None if self.h is not None else float(np.min(self.rtol))
