"""Functions of the solution that are evaluated at output times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cg.frames.base import Frame
from cg.integration.rhs.checks import read_finite
from cg.integration.rhs.compiled import CompiledRhs, compiled_event
from cg.integration.rhs.events import EventTable
from cg.integration.rhs.inputs import WithInput, members_with_data
from cg.integration.rhs.python import Contexts, PythonRhs
from cg.support.arrays import Array, Points

STORED = "all", "observed"


@dataclass(frozen=True, eq=False)
class Observer:
    """What is evaluated at output times, after checking."""

    function: Any  # in Python, or a list of compiled ones
    frame: Frame  # frame of the points that it is given
    shape: tuple[int, ...]  # shape of its value at one time
    keeps_points: bool  # whether the points are stored as well

    def check(self, value: Any, t: float, _: Points) -> Array:
        """Return a value as an array, after checking it."""
        return read_finite(value, "observe", self.shape, t)

    def fields(self, rhs: CompiledRhs | PythonRhs) -> tuple[dict[str, int], Any]:
        """Return entries of the record of a run, and what has to stay alive with them."""
        if isinstance(self.function, list):
            data, stride = rhs.addresses()[1:] if isinstance(rhs, CompiledRhs) else (0, 0)
            if isinstance(rhs, PythonRhs) and rhs.inputs is not None:
                raise ValueError("observe must be in Python with inputs if f is, got compiled ones")
            if isinstance(rhs, PythonRhs) and rhs.parameters is not None:
                data, stride = rhs.parameters.ctypes.data, rhs.parameters.strides[0]
            table = EventTable(self.function, self.frame).rows
            entries = {"observers": len(table), "observer_table": table.ctypes.data}
            return entries | {"observer_data": data, "observer_stride": stride}, table
        count = members_with_data(rhs.inputs, rhs.parameters)
        rest = self.frame, self.shape, self.check
        contexts = Contexts(self.function, rhs.arguments, count, *rest)
        names = "observer", "observer_data", "observer_stride"
        return dict(zip(names, contexts.addresses(), strict=True)), contexts

    @property
    def count(self) -> int:
        """Numbers at a time."""
        return math.prod(self.shape)


def observer_of(
    observe: Any, store: Any, frame: Frame, rhs: CompiledRhs | PythonRhs, t: float, y: Points
) -> Observer | None:
    """Return what is evaluated at output times, after calling it at the initial point."""
    if not isinstance(store, str) or store not in STORED:
        raise ValueError(f"store must be {' or '.join(map(repr, STORED))}, got {store!r}")
    if observe is None:
        if store != "all":
            raise ValueError(f"observe must be given with store={store!r}, got None")
        return None
    keeps_points = store == "all"
    if compiled_event(observe) is not None:
        return Observer([observe], frame, (), keeps_points)
    if isinstance(observe, Sequence) and observe and all(map(compiled_event, observe)):
        return Observer(list(observe), frame, (len(observe),), keeps_points)
    if not callable(observe):
        raise TypeError(
            "observe must be callable as observe(t, y), or a list of compiled functions, got "
            f"{observe!r}"
        )
    if rhs.inputs is not None:
        observe = WithInput(observe)
    visible = y.copy()
    visible.flags.writeable = False
    shape = np.shape(observe(t, visible, *rhs.arguments(0)))
    observer = Observer(observe, frame, shape, keeps_points)
    if not observer.count:
        raise ValueError(f"observe must return at least one number, got shape {shape}")
    return observer
