"""The parts of a search at order six with 16 stages: residual, Jacobian, step, refinement."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import leastsq

import cg
from cg import _core_r64, _core_r128
from cg.conditions import condition_trees, pack, unknowns
from cg.construction.search.start import random_start
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.refine import refine
from cg.construction.solvers.system import ConditionSystem
from cg.support import quads

from .leastsq import PaddedResidual
from .record import Aim, Result
from .timing import measure
from .weights import NumpyResidual

ORDER, STAGES = 6, 16
TITLE = "Kernels at order six with 16 stages"
_ITERATIONS = 25
_METHOD = "CG6c"

Array = NDArray[np.float64]

_ROWS = (
    # quantity, contestant, unit, aim, competitor, its contestant
    ("residual of the 113 conditions", "residual", "µs", 40.0,
     "the same recursion in NumPy, all rows at once", "residual, NumPy"),
    ("Jacobian, 113 × 136", "jacobian", "ms", 1.5,
     "differences of the compiled residual", "jacobian, differences"),
    ("one step of the minimum-norm solver", "iteration", "ms", 3.0,
     "one step of SciPy's leastsq with the same residual and Jacobian", "iteration, leastsq"),
    ("refinement to the rounding error of binary128", "refinement", "ms", 60.0,
     "the same with NumPy's lstsq in each correction", "refinement, lstsq"),
)  # fmt: skip


def method_text(rounds: int) -> str:
    """Return how the kernels are measured."""
    return f"Medians of {rounds} rounds. Refinement starts from `{_METHOD}` rounded to double."


class Kernels:
    """The compiled kernels at one point, and the same computations in NumPy and SciPy."""

    def __init__(self) -> None:
        self.system = ConditionSystem.tableau(ORDER, STAGES)
        self.x = random_start(1, 0, unknowns(STAGES), 0.3)
        self.trees = np.array(condition_trees(ORDER, independent=True), dtype=np.intc)
        self.padded = PaddedResidual(ORDER, STAGES)
        method = cg.methods[_METHOD]
        self.near = quads.from_float(pack(method.a, method.b))
        self.leastsq_iterations = 1

    def residual(self, x: Array) -> Array:
        """Return the compiled residuals."""
        residuals: Array = _core_r64.residuals(ORDER, self.system.layout.code, x, self.trees)
        return residuals

    def jacobian(self) -> Array:
        """Return the compiled Jacobian."""
        code = self.system.layout.code
        jacobian: Array = _core_r64.jacobian(ORDER, code, self.x, self.trees)
        return jacobian

    def differences(self) -> Array:
        """Return the Jacobian by forward differences."""
        steps = np.sqrt(np.finfo(float).eps) * np.maximum(1.0, np.abs(self.x))
        base = self.residual(self.x)
        columns = [
            (self.residual(self.x + step * unit) - base) / step
            for step, unit in zip(steps, np.eye(self.x.size), strict=True)
        ]
        return np.stack(columns, axis=1)

    def iterate(self) -> None:
        """Take steps of the minimum-norm solver."""
        fit = fit_conditions(self.x, self.system, max_iterations=_ITERATIONS)
        assert fit.iterations == _ITERATIONS

    def iterate_leastsq(self) -> None:
        """Take steps of SciPy's leastsq."""
        _, _, info, _, _ = leastsq(
            self.padded, self.x, Dfun=self.padded.jacobian, full_output=True,
            maxfev=_ITERATIONS, ftol=0, xtol=0,
        )  # fmt: skip
        self.leastsq_iterations = int(info["nfev"])

    def refine_lstsq(self) -> float:
        """Refine with NumPy's lstsq until the largest residual no longer decreases."""
        point, best = self.near, np.inf
        while True:
            residual = self.system.residual_quad(point)
            largest = float(np.abs(residual).max())
            if not largest < best:
                return best
            best = largest
            jacobian = self.system.jacobian(quads.to_float(point), independent=False)
            step = np.linalg.lstsq(jacobian, residual, rcond=1e-10)[0]
            point = np.ascontiguousarray(_core_r128.subtract_double(point.T, step).T)


def run(quick: bool, figures: Path | None) -> Result:
    """Measure each kernel, and the same computation in NumPy or SciPy."""
    rounds = 3 if quick else 9
    kernels, reference = Kernels(), NumpyResidual(ORDER, STAGES)
    x = kernels.x
    np.testing.assert_allclose(reference(x), kernels.residual(x), atol=1e-13)
    np.testing.assert_allclose(kernels.differences(), kernels.jacobian(), rtol=0, atol=1e-5)
    times = measure(
        {
            "residual": lambda: kernels.residual(x),
            "residual, NumPy": lambda: reference(x),
            "jacobian": kernels.jacobian,
            "jacobian, differences": kernels.differences,
            "iteration": kernels.iterate,
            "iteration, leastsq": kernels.iterate_leastsq,
            "refinement": lambda: refine(kernels.near, kernels.system),
            "refinement, lstsq": kernels.refine_lstsq,
        },
        rounds=rounds,
    )
    iterations = _ITERATIONS, kernels.leastsq_iterations
    rows = tuple(
        times.row(
            quantity, name, unit, against, other,
            pieces=iterations if name == "iteration" else (1, 1), aim=Aim(limit, False, "value"),
        )
        for quantity, name, unit, limit, against, other in _ROWS
    )  # fmt: skip
    return Result(TITLE, method_text(rounds), rows)
