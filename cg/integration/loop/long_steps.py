"""Detection of steps that are far too long, for a warning after an integration."""

from __future__ import annotations

import numpy as np

from cg.frames.arrays import Array
from cg.frames.base import Frame
from cg.integration.loop.run import Run
from cg.integration.step.plan import has_brackets

_SHORT = 1.0  # length of coefficients that no frame has beyond the radius of dexp⁻¹
_MAX_DIM = 1000  # larger frames would need much memory for the check


def takes_long_steps(run: Run) -> bool:
    """Return whether the last step of a single trajectory was far too long.

    It isn't checked on frames of more than 1000 fields.
    """
    frame = run.plan.frame
    return frame.dim <= _MAX_DIM and is_too_long(frame, run.last_stages())


def is_too_long(frame: Frame, stages: Array) -> bool:
    """Return whether coefficients differ between stages by more than the radius of dexp⁻¹.

    For rotations the radius is a full turn. Coefficients that commute have none, and those that
    the stages have in common don't matter: flows along them are exact. ``stages`` are the
    coefficients at the stages of a step times its size, shape ``(stages, dim)``.
    """
    change = stages - stages[0]
    if not np.square(change).sum(axis=1).max() > _SHORT or not has_brackets(frame):
        return False
    return not np.isfinite(frame.dexpinv(change, stages)).all()
