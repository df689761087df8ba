"""What Python passes to a run of compiled code: its record, step size control and output."""

from __future__ import annotations

import ctypes
import math
from typing import Any, NamedTuple

import numpy as np

from cg.frames.arrays import Array
from cg.support.shared_numbers import RECORD

_KINDS: dict[str, Any] = {
    "integer": ctypes.c_int64,
    "real": ctypes.c_double,
    "address": ctypes.c_void_p,
}
COUNTS = ("nfev", "nexp", "njev", "nlu", "steps", "nrejected")
"""Counts of each member, in the order of compiled code."""


class Record(ctypes.Structure):
    """The record that compiled code reads and writes."""

    _fields_ = [(name, _KINDS[kind]) for name, kind in RECORD.items()]


class Control(NamedTuple):
    """The step size control."""

    h: float | None = None  # size of equal steps, None for adaptive steps
    rtol: float = 1e-3
    atol: Array = np.array([1e-6])
    max_step: float = math.inf
    first_step: float | None = None
    max_steps: int = 10**6  # rejected ones included
