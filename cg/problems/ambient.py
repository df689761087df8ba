"""Reference solutions in double precision, in the space around a manifold."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy

from cg.frames.arrays import Array
from cg.problems.checks import times_array


def ambient_solution(
    right: Callable[[float, Array], Array], y0: Array, times: Sequence[float]
) -> Array:
    """Return a solution from time zero, accurate to about 1e-11, shape ``(n, len(y0))``.

    It is SciPy's DOP853 at its smallest tolerance, and knows nothing of frames.

    Raises
    ------
    ValueError
        If the times aren't finite and increasing from zero or later.
    """
    wanted = times_array(times)
    if wanted.ndim != 1 or len(wanted) < 1 or wanted[0] < 0 or (np.diff(wanted) <= 0).any():
        raise ValueError(f"times must increase from zero or later, got {times!r}")
    end = float(wanted[-1]) or 1.0
    solution = scipy.integrate.solve_ivp(
        right, (0.0, end), y0, method="DOP853", rtol=3e-14, atol=1e-15, t_eval=wanted
    )
    return np.asarray(solution.y.T)
