"""The heavy top by Lielab's Crouch-Grossman method."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.problems import HeavyTop


class LielabTop:
    """The top on SO(3) x R^3, with Lielab's CG4a and fixed steps.

    Lielab moves points from the left, so that its right-hand side gives the angular velocity
    in space axes.

    Parameters
    ----------
    top : HeavyTop
    """

    def __init__(self, top: HeavyTop) -> None:
        from lielab.domain import RN, SO, CompositeAlgebra, CompositeManifold, rn, so
        from lielab.integrate import (
            CrouchGrossmanCoefficients,
            HomogeneousIVPSystem,
            IVPMethod,
            IVPOptions,
            solve_ivp,
        )

        self.solve_ivp = solve_ivp
        self.options = IVPOptions()
        self.options.method = IVPMethod.CrouchGrossman
        self.options.crouch_grossman_coefficients = CrouchGrossmanCoefficients.CG4a
        self.options.variable_time_step = False
        self.options.dt_min = 1e-9
        y0 = top.y0
        momentum = RN(3)
        momentum.unserialize(y0[9:])
        self.start = CompositeManifold([SO(y0[:9].reshape(3, 3)), momentum])
        inverse1, inverse2, inverse3 = (float(1 / moment) for moment in top.inertia)
        mgl = float(top.mgl)
        rotation_rate, momentum_rate = so(3), rn(3)

        def f(t: float, y: Any) -> Any:
            matrix, momentum = y.point
            rotation = matrix.get_matrix()
            up1, up2, _ = rotation[2].tolist()
            m1, m2, m3 = momentum.serialize().tolist()
            w1, w2, w3 = inverse1 * m1, inverse2 * m2, inverse3 * m3
            rotation_rate.set_vector(rotation @ (w1, w2, w3))
            momentum_rate.set_vector(
                [m2 * w3 - m3 * w2 + mgl * up2, m3 * w1 - m1 * w3 - mgl * up1, m1 * w2 - m2 * w1]
            )
            return CompositeAlgebra([rotation_rate, momentum_rate])

        self.system = HomogeneousIVPSystem(f)

    def integrate(self, h: float, steps: int) -> NDArray[np.float64]:
        """Return all points, shape ``(steps + 1, 12)``."""
        self.options.dt = h
        solution = self.solve_ivp(self.system, np.array([0.0, h * steps]), self.start, self.options)
        points = np.asarray(solution.ybar)
        if points.shape != (steps + 1, 12):
            raise RuntimeError(f"Lielab made {len(points) - 1} steps, not {steps}")
        return points
