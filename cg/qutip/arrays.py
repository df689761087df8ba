"""Coefficients that QuTiP interpolates between the entries of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from qutip.core.cy.coefficient import Coefficient, InterCoefficient

from cg.integration.rhs.samples import Samples
from cg.support.arrays import Array

_KINDS = {1: "hold", 2: "linear"}  # by number of coefficients of a piece, else splines


def times_of_arrays(coefficient: Any, tolerance: float) -> Array:
    """Return times at which steps must end, so that none passes over what a coefficient does.

    Sums and products contain others, which are found as for a pickle.
    """
    found, rest = [np.empty(0)], [coefficient]
    while rest:
        part = rest.pop()
        if isinstance(part, tuple | list):
            rest += part
        elif isinstance(part, Coefficient):
            _, arguments, *state = part.__reduce__()
            if isinstance(part, InterCoefficient):
                found.append(_times(arguments[0], arguments[1], tolerance))
            else:
                rest += arguments, *state
    return np.unique(np.concatenate(found))


def _times(times: Array, pieces: Any, tolerance: float) -> Array:
    """Return those times of one array; the last row of its pieces has its values."""
    values = np.stack([pieces[-1].real, pieces[-1].imag], axis=1)
    curve = Samples(times, values, _KINDS.get(len(pieces), "cubic"))
    ends = curve.times[[0, -1]]
    return np.concatenate([ends, curve.corners(tolerance), curve.longest_steps(tolerance)[:, 0]])
