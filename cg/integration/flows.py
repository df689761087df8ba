"""Flows of the rows of a method, and differences of points: compiled for the frames that are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Array, Frame, Points
from cg.integration.blocks import describe_blocks, is_compiled

__all__ = ["CompiledDifference", "Flows", "Row", "flows_of"]

Row = tuple[tuple[int, float], ...]
"""The coefficients of a row that aren't zero, each after its stage (from 0)."""

Flows = Callable[[Row, Array, Points, float], Points]
"""``flows(row, fields, point, h)`` moves ``point`` along ``h`` times each coefficient of a row
times the field of its stage; ``fields`` has shape ``(*batch, stages, dim)``."""


def flows_of(frame: Frame) -> Flows:
    """Return the function that applies the flows of a row, the first one first."""
    return _CompiledFlows(frame) if is_compiled(frame) else _Flows(frame)


class _Flows:
    def __init__(self, frame: Frame) -> None:
        self.frame = frame

    def __call__(self, row: Row, fields: Array, point: Points, h: float) -> Points:
        for j, coefficient in row:
            point = self.frame.flow(h * coefficient * fields[..., j, :], point)
        return point


class _CompiledFlows:
    """One call moves points along all flows of a row: calls cost more than the arithmetic."""

    def __init__(self, frame: Frame) -> None:
        import cg._external as core

        self.frame = frame
        self.move = core.move
        self.description = describe_blocks(frame)
        self.rows: dict[Row, tuple[Array, NDArray[np.intc]]] = {}

    def __reduce__(self) -> tuple[Callable[[Frame], Flows], tuple[Frame]]:
        return flows_of, (self.frame,)  # compiled functions can't be pickled

    def __call__(self, row: Row, fields: Array, point: Points, h: float) -> Points:
        known = self.rows.get(row)
        if known is None:
            stages, weights = zip(*row, strict=True)
            known = np.array(weights), np.array(stages, dtype=np.intc) + np.intc(1)
            self.rows[row] = known
        moved = np.array(point, dtype=self.frame.dtype, order="C")
        self.move(
            self.description,
            h,
            *known,
            fields.shape[-2],
            np.ascontiguousarray(fields).reshape(-1),
            moved.reshape(-1).view(np.float64),
        )
        return moved


class CompiledDifference:
    """The compiled counterpart of `Frame.exp_coordinates`, for the frames that have one.

    Parameters
    ----------
    frame
        One of which `is_compiled` is true.
    """

    def __init__(self, frame: Frame) -> None:
        import cg._external as core

        self.frame = frame
        self.difference = core.difference
        self.description = describe_blocks(frame)

    def __reduce__(self) -> tuple[type[CompiledDifference], tuple[Frame]]:
        return CompiledDifference, (self.frame,)

    def __call__(self, y0: Points, y1: Points) -> Array:
        """Return the coefficients of the flows from ``y0`` to ``y1``, shape ``(..., dim)``.

        Parameters
        ----------
        y0, y1
            Points of equal shape ``(..., *point_shape)``.
        """
        rank = len(self.frame.point_shape)
        found = np.empty((*y0.shape[: y0.ndim - rank], self.frame.dim))
        self.difference(self.description, _flat(y0), _flat(y1), found.reshape(-1))
        return found


def _flat(y: Points) -> Array:
    return np.ascontiguousarray(y).reshape(-1).view(np.float64)
