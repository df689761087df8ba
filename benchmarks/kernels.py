"""The parts of a search at order six with 16 stages: residual, Jacobian, step, refinement."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.optimize import leastsq

import cg
from cg import _core_r64, _core_r128
from cg.conditions import condition_trees, pack, unknowns
from cg.construction.search.random_search import random_start
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.refine import refine
from cg.construction.solvers.system import ConditionSystem
from cg.support import quads

from .leastsq import PaddedResidual
from .record import Aim, Result
from .timing import measure
from .weights import NumpyResidual

ORDER, STAGES = 6, 16
_ITERATIONS = 25


def run(quick: bool, figures: Path | None) -> Result:
    """Measure each kernel against NumPy and SciPy doing the same."""
    rounds = 3 if quick else 9
    system = ConditionSystem.tableau(ORDER, STAGES)
    shape = ORDER, system.layout.code
    x = random_start(1, 0, unknowns(STAGES), 0.3)
    trees = np.array(condition_trees(ORDER, independent=True), dtype=np.intc)
    reference = NumpyResidual(ORDER, STAGES)
    np.testing.assert_allclose(reference(x), _core_r64.residuals(*shape, x, trees), atol=1e-13)

    def differences() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        steps = np.sqrt(np.finfo(float).eps) * np.maximum(1.0, np.abs(x))
        base = _core_r64.residuals(*shape, x, trees)
        columns = np.empty((len(trees), x.size))
        for j, step in enumerate(steps):
            moved = x.copy()
            moved[j] += step
            columns[:, j] = (_core_r64.residuals(*shape, moved, trees) - base) / step
        return columns

    exact = _core_r64.jacobian(*shape, x, trees)
    np.testing.assert_allclose(differences(), exact, rtol=0, atol=1e-5)

    padded = PaddedResidual(ORDER, STAGES)
    iterations = {"leastsq": 1}

    def ours() -> None:
        fit = fit_conditions(x, system, max_iterations=_ITERATIONS)
        assert fit.iterations == _ITERATIONS

    def scipys() -> None:
        _, _, info, _, _ = leastsq(
            padded, x, Dfun=padded.jacobian, full_output=True, maxfev=_ITERATIONS, ftol=0, xtol=0
        )
        iterations["leastsq"] = int(info["nfev"])

    method = cg.methods["CG6c"]
    near = quads.from_float(pack(method.a, method.b))

    def factored_again() -> float:
        point = near
        best = np.inf
        while True:
            residual = system.residual_quad(point)
            largest = float(np.abs(residual).max())
            if not largest < best:
                return best
            best = largest
            jacobian = system.jacobian(quads.to_float(point), independent=False)
            step = np.linalg.lstsq(jacobian, residual, rcond=1e-10)[0]
            point = np.ascontiguousarray(_core_r128.subtract_double(point.T, step).T)

    times = measure(
        {
            "residual": lambda: _core_r64.residuals(*shape, x, trees),
            "residual, NumPy": lambda: reference(x),
            "jacobian": lambda: _core_r64.jacobian(*shape, x, trees),
            "jacobian, differences": differences,
            "iteration": ours,
            "iteration, leastsq": scipys,
            "refinement": lambda: refine(near, system),
            "refinement, lstsq": factored_again,
        },
        rounds=rounds,
    )
    rows = tuple(
        times.row(
            quantity, name, unit, against, other, pieces=pieces, aim=Aim(limit, False, "value")
        )
        for quantity, name, unit, limit, against, other, pieces in (
            (
                "residual of the 113 conditions", "residual", "µs", 40.0,
                "the same recursion in NumPy, all rows at once", "residual, NumPy", (1, 1),
            ),
            (
                "Jacobian, 113 × 136", "jacobian", "ms", 1.5,
                "differences of the compiled residual", "jacobian, differences", (1, 1),
            ),
            (
                "one step of the minimum-norm solver", "iteration", "ms", 3.0,
                "one step of SciPy's leastsq with the same residual and Jacobian",
                "iteration, leastsq", (_ITERATIONS, iterations["leastsq"]),
            ),
            (
                "refinement to the floor of binary128", "refinement", "ms", 60.0,
                "the same with NumPy's lstsq in each correction", "refinement, lstsq", (1, 1),
            ),
        )
    )  # fmt: skip
    return Result(
        "Kernels at order six with 16 stages",
        f"Medians of {rounds} rounds; refinement starts from {method.name} rounded to double.",
        rows,
    )
