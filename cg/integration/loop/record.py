"""What Python passes to a run of compiled code: its record, step size control and output."""

from __future__ import annotations

import ctypes
import math
from typing import NamedTuple

import numpy as np

from cg.frames.arrays import Array
from cg.support.records import fields_of
from cg.support.shared_numbers import COUNTERS, RECORD

COUNTS = tuple(COUNTERS)[2:]
"""Counts of each member, in the order of compiled code."""


class Record(ctypes.Structure):
    """The record that compiled code reads and writes."""

    _fields_ = fields_of(RECORD)


class Control(NamedTuple):
    """The step size control.

    Attributes
    ----------
    h
        Size of equal steps, None for adaptive steps.
    rtol, atol
        Tolerances, ``atol`` of shape () or that of `Plan.tolerance_shape`.
    max_step, first_step
        Largest size and first size, None to choose the first one.
    max_steps
        Largest number of adaptive steps, rejected ones included.
    """

    h: float | None = None
    rtol: float = 1e-3
    atol: Array = np.array([1e-6])
    max_step: float = math.inf
    first_step: float | None = None
    max_steps: int = 10**6


class Output(NamedTuple):
    """The output of trajectories.

    Attributes
    ----------
    times
        Output times, or None.
    every
        Number of steps between stored steps; 0 to store none.
    dense
        Whether to store interpolants.
    y
        Array for the points at ``times``, shape ``(times, members, width)``, or None.
    capacity
        The number of steps to store, 0 if it isn't known.
    """

    times: Array | None = None
    every: int = 0
    dense: bool = False
    y: Array | None = None
    capacity: int = 0
