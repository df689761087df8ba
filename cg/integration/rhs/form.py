"""The form of right-hand sides: coefficients of fields, or derivatives of points."""

from typing import Any

import numpy as np

from cg.frames.base import Frame
from cg.frames.manifold import FLOAT64
from cg.support.arrays import Array, Points


def templates_of(
    frame: Frame, shape: tuple[int, ...], dtype: Any = FLOAT64
) -> tuple[Points, Points]:
    """Return arrays like the points of a function, and like its results."""
    return np.empty(frame.point_shape, frame.dtype), np.empty(shape, dtype)


class RhsForm:
    """The form of right-hand sides on a frame: ``shape`` and ``dtype`` of a result."""

    def __init__(self, frame: Frame, derivatives: bool = False) -> None:
        self.frame, self.derivatives = frame, derivatives
        self.shape = frame.point_shape if derivatives else (frame.rhs_dim,)
        self.dtype = frame.dtype if derivatives else FLOAT64
        self.templates = templates_of(frame, self.shape, self.dtype)

    def complete(self, f: Points, y: Points) -> Array:
        """Return all coefficients, shape ``(..., dim)``, for results f at points y."""
        if self.derivatives:
            return self.frame._coefficients(y, f)[0]
        return self.frame.complete_rhs(f, y)
