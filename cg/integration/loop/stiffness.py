"""Detection of stiff equations, for the message of an integration that takes too many steps."""

from __future__ import annotations

import numpy as np

from cg.catalogue.summary import summary_of
from cg.frames.arrays import Points
from cg.frames.base import Frame
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.python import PythonRhs
from cg.method.method import Method

_MAX_DIM = 300
_STEP = float(np.sqrt(np.finfo(np.float64).eps))
# of the real stability limit, where steps whose size stability limits end up
_NEAR_LIMIT = 0.5
# least damping of an eigenvalue, relative to its size
_DAMPED = 0.05


def is_stiff(
    frame: Frame,
    method: Method,
    rhs: CompiledRhs | PythonRhs,
    member: int,
    t: float,
    y: Points,
    h: float,
) -> bool:
    """Return whether the stability of an explicit method limits its steps at a point.

    It does if a step of size ``h`` takes a damped eigenvalue of the Jacobian, which this function
    computes by differences, near the limit of the method's stability.
    """
    limit = summary_of(method).real_stability
    if limit is None or frame.dim > _MAX_DIM or not method.explicit:
        return False
    steps = _STEP * np.maximum(frame.coordinate_sizes(y), 1.0)
    try:
        start = rhs.at_member(member, t, y)
        moved = [rhs.at_member(member, t, frame.flow(v, y)) for v in np.diag(steps)]
        values = np.linalg.eigvals((np.array(moved) - start).T / steps)
    except (ValueError, ArithmeticError, RuntimeError):
        return False
    damped = values[values.real <= -_DAMPED * np.abs(values)]
    return bool(abs(h) * np.abs(damped).max(initial=0.0) >= _NEAR_LIMIT * limit)
