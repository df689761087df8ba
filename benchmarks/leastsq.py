"""SciPy's MINPACK on the compiled residual: what the project's solvers are compared with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import leastsq

from cg import _core_r64
from cg.conditions import table_rows, unknowns
from cg.structure.layout import Layout


class PaddedResidual:
    """Residuals with rows of zeros for trees that can be discarded, as the paper has them.

    MINPACK refuses fewer residuals than unknowns; more zeros are appended where needed.

    Parameters
    ----------
    order, stages : int
    """

    def __init__(self, order: int, stages: int) -> None:
        self.shape = order, Layout.tableau(stages).code
        rows = np.array(table_rows(order), dtype=np.intc)
        self.trees = np.pad(rows, (0, max(0, unknowns(stages) - len(rows))))
        self.trees_alone = rows[rows > 0]

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the residuals, shape ``(rows,)``."""
        residuals: NDArray[np.float64] = _core_r64.residuals(*self.shape, x, self.trees)
        return residuals

    def jacobian(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives, shape ``(rows, unknowns)``."""
        derivatives = np.zeros((len(self.trees), x.size))
        nonzero = np.flatnonzero(self.trees)
        derivatives[nonzero] = _core_r64.jacobian(*self.shape, x, self.trees_alone)
        return derivatives


def solve(
    residual: PaddedResidual, guess: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Run ``leastsq`` with the paper's tolerances; return where it ended and the sum of squares."""
    x, _, info, _, _ = leastsq(
        residual, guess, full_output=True, xtol=1e-18, ftol=1e-18, gtol=0.0,
        maxfev=200 * (guess.size + 1),
    )  # fmt: skip
    return x, float(np.sum(info["fvec"] ** 2))
