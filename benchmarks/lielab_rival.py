"""Lielab's methods of Munthe-Kaas with chosen steps, on the cases that it can express."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames import SO3, Euclidean, Product

from .cases import Case
from .lielab_top import available

METHODS = {"RKV87r": 8, "RKV98r": 9, "RKDP54_7M": 5}
"""Its pairs, and their orders: the default, the one of highest order, Dormand and Prince's."""


def expresses(case: Case) -> bool:
    """Return whether Lielab is installed and has the frame, and f is a function in Python.

    It has rotation matrices and numbers, but no quaternions, conjugation or lattices of groups.
    """
    return available() and callable(case.f) and case.frame == Product(SO3(), Euclidean(3))


class LielabRival:
    """A case on SO(3) x R^3 by a pair of Lielab.

    It moves points from the left, so that angular velocities become those in space axes.

    Parameters
    ----------
    case : Case
    name : str
        Of the coefficients, one of `METHODS`.

    Attributes
    ----------
    evaluations : int
        Of the last integration.
    """

    def __init__(self, case: Case, name: str) -> None:
        from lielab.domain import RN, SO, CompositeAlgebra, CompositeManifold, rn, so
        from lielab.integrate import (
            HomogeneousIVPSystem,
            IVPMethod,
            IVPOptions,
            RungeKuttaCoefficients,
            solve_ivp,
        )

        self.evaluations = 0
        self._solve: Callable[..., Any] = solve_ivp
        self._span = np.array([0.0, case.end])
        self._options = IVPOptions()
        self._options.method = IVPMethod.MuntheKaas
        self._options.coefficients = getattr(RungeKuttaCoefficients, name)
        self._options.dt_min = 1e-12
        numbers = RN(3)
        numbers.unserialize(case.y0[9:])
        self._start = CompositeManifold([SO(case.y0[:9].reshape(3, 3)), numbers])
        turn, rate = so(3), rn(3)
        flat = np.empty(12)
        f: Any = case.f

        def right_side(t: float, y: Any) -> Any:
            self.evaluations += 1
            matrix, numbers = y.point
            rotation = matrix.get_matrix()
            flat[:9] = rotation.ravel()
            flat[9:] = numbers.serialize()
            rates = f(t, flat)
            turn.set_vector(rotation @ rates[:3])
            rate.set_vector(rates[3:])
            return CompositeAlgebra([turn, rate])

        self._system = HomogeneousIVPSystem(right_side)

    def integrate(self, tolerance: float) -> NDArray[np.float64]:
        """Return the points of all steps, shape ``(steps + 1, 12)``.

        Raises
        ------
        RuntimeError
            If it doesn't get to the end.
        """
        self.evaluations = 0
        self._options.reltol = self._options.abstol = tolerance
        solution = self._solve(self._system, self._span, self._start, self._options)
        if not abs(solution.t[-1] - self._span[1]) < 1e-12:
            raise RuntimeError(f"Lielab ended at t = {solution.t[-1]}")
        return np.asarray(solution.ybar)
