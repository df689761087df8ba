"""Derivatives by differences, whose errors are computed too."""

import numpy as np


def derivative(function, bound, step=0.02):
    """Return the derivative of a function of one number at zero, better known than a bound.

    Central differences are extrapolated to a step of zero while the step is halved (Ridders,
    Advances in Engineering Software 4, 1982). The error is the change by the last halving.
    """
    best, row = np.inf, []
    for _ in range(8):
        finer = [np.subtract(function(step), function(-step)) / (2 * step)]
        for k, coarse in enumerate(row, 1):
            finer.append(finer[-1] + (finer[-1] - coarse) / (4**k - 1))
        if len(row) > 1:
            error = max(np.abs(finer[-1] - other).max() for other in (finer[-2], row[-1]))
            best = min(best, error)
            if error < bound / 3:
                return finer[-1]
        row, step = finer, step / 2
    raise AssertionError(f"the reference has an error of {best:.1e}, the bound is {bound:.1e}")


def jacobian(function, count, bound):
    """Return the derivatives of a vector by ``count`` numbers at zero, shape (vector, count)."""
    columns = [derivative(lambda s, e=e: function(s * e), bound) for e in np.eye(count)]
    return np.transpose(columns)
