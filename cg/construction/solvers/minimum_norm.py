"""The fast solver of order conditions: exact Jacobian, steps of least norm.

Levenberg–Marquardt with geodesic acceleration, in double, wholly compiled; dense linear
algebra by the LAPACK that SciPy brings.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cython_blas, cython_lapack

from cg import _core_r64

from ...conditions.compiled import fit_minimum_norm
from ...support.checks import MAX_COUNT, check_flag, check_integer, check_real
from ...support.parallel import stoppable
from ...support.shared_numbers import MinimumNormStatus
from .system import ConditionSystem

__all__ = ["MinimumNormFit", "MinimumNormStatus", "fit_conditions"]

_BRIEF = 10**8  # multiplications: about a tenth of a second


@dataclass(frozen=True)
class MinimumNormFit:
    """Where a fit ended.

    Attributes
    ----------
    x : ndarray, shape (n,)
        Packed weights.
    f : float
        Sum of squared residuals of the independent conditions.
    iterations, evaluations : int
        Steps tried, and evaluations of the residuals.
    status : MinimumNormStatus
    """

    x: NDArray[np.float64]
    f: float
    iterations: int
    evaluations: int
    status: MinimumNormStatus


def fit_conditions(
    x0: ArrayLike,
    system: ConditionSystem,
    *,
    free: Sequence[int] | NDArray[np.intp] | None = None,
    ftol: float = 1e-27,
    damping: float = 1e-2,
    max_iterations: int = 1000,
    accurate: bool = False,
) -> MinimumNormFit:
    """Minimise the sum of squared residuals of the independent order conditions.

    Works for any numbers of conditions and unknowns, and is meant for more unknowns
    than conditions.

    Parameters
    ----------
    x0 : array_like, shape (n,)
        Packed weights to start from, as ``system.layout`` says; zeros that the system asks
        for must be there.
    system : ConditionSystem
        Simplifying assumptions of its structure are solved for together with the conditions.
    free : sequence of int, optional
        Indices (from 0) of the unknowns that may move; by default all that aren't zero
        by definition.
    ftol : float, optional
        Stop when the sum of squares is at most this.
    damping : float, optional
        First damping, relative to the largest squared norm of a row of the Jacobian;
        small close to a solution.
    max_iterations : int, optional
    accurate : bool, optional
        Take steps from a QR factorisation, which takes up to three times as long, instead
        of normal equations, which lose singular values below 1e-8 of the largest.

    Returns
    -------
    MinimumNormFit

    Raises
    ------
    ValueError
        If `x0` doesn't fit the system or isn't finite, `free` has a wrong index, or a number
        is out of its range.
    """
    size = system.size
    x = np.array(x0, dtype=np.float64)
    if x.shape != (size,) or not np.isfinite(x).all():
        raise ValueError(f"x0 must have {size} finite entries, got shape {x.shape}: {x}")
    indices = system.moving(free)
    ftol = check_real("ftol", ftol)
    damping = check_real("damping", damping, positive=True)
    max_iterations = check_integer("max_iterations", max_iterations, 0, MAX_COUNT)
    accurate = check_flag("accurate", accurate)
    trees, owner = system.conditions(independent=True)
    moving = (indices + 1).astype(np.intc)
    problem = (system.order, system.layout, x, trees, owner)
    most = max_iterations * trees.size**2 * moving.size  # for the Gram matrices
    found, f, iterations, evaluations, status = stoppable(
        lambda stop_flag: fit_minimum_norm(
            *problem, moving, ftol, damping, max_iterations, accurate, stop_flag
        ),
        brief=most <= _BRIEF,
    )
    return MinimumNormFit(
        found, float(f), int(iterations), int(evaluations), MinimumNormStatus(status)
    )


def _address(capsules: Mapping[str, object], name: str) -> int:
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetName.argtypes = [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    capsule = capsules[name]
    return int(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


_core_r64.set_lapack(
    [
        _address(cython_blas.__pyx_capi__, "dsyrk"),
        _address(cython_lapack.__pyx_capi__, "dpotrf"),
        _address(cython_lapack.__pyx_capi__, "dpotrs"),
        _address(cython_lapack.__pyx_capi__, "dgeqrf"),
    ]
)
