"""Magnus methods of orders four and six for linear equations, to compare with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.matrix_group import MatrixGroup

Array = NDArray[np.float64]
Points = NDArray[Any]


class Magnus:
    r"""One exponential a step, of an integral of the coefficients and commutators of them.

    With :math:`\alpha_i = h^i \Omega^{(i-1)} / (i-1)!` about the middle of a step, from Gauss's
    nodes, the exponent of order four is :math:`\alpha_1 + \alpha_3/12 - [\alpha_1, \alpha_2]/12`,
    and that of order six is in [1]_.

    Parameters
    ----------
    f : callable
        ``f(t, y)`` returns coefficients that don't depend on ``y``.
    group : MatrixGroup
    order : {4, 6}

    Attributes
    ----------
    nfev, nexp : int
        Evaluations and flows so far.

    References
    ----------
    .. [1] S. Blanes, F. Casas, J. A. Oteo, J. Ros, "The Magnus expansion and some of its
       applications", Phys. Rep. 470 (2009), 151-238, section 5.4.
    """

    def __init__(self, f: Callable[[float, Any], Any], group: MatrixGroup, order: int) -> None:
        self.f, self.group, self.order = f, group, order
        self.constants = group.structure_constants * (1.0 if group.convention == "space" else -1.0)
        self.nfev = self.nexp = 0

    def integrate(self, end: float, y0: Points, steps: int) -> Points:
        """Return all points from time 0 on, shape ``(steps + 1, *y0.shape)``."""
        h = end / steps
        points = np.empty((steps + 1, *y0.shape), dtype=y0.dtype)
        points[0] = y = y0
        exponent = self._fourth if self.order == 4 else self._sixth
        for k in range(steps):
            points[k + 1] = y = self.group.flow(exponent((k + 0.5) * h, h, y), y)
            self.nexp += 1
        return points

    def _at(self, t: float, y: Points) -> Array:
        self.nfev += 1
        return np.asarray(self.f(t, y), dtype=np.float64)

    def _bracket(self, u: Array, v: Array) -> Array:
        return np.asarray(np.einsum("i,j,ijk->k", u, v, self.constants))

    def _fourth(self, t: float, h: float, y: Points) -> Array:
        node = h * np.sqrt(3.0) / 6.0
        a, b = self._at(t - node, y), self._at(t + node, y)
        return np.asarray(0.5 * h * (a + b) - h * h * np.sqrt(3.0) / 12.0 * self._bracket(a, b))

    def _sixth(self, t: float, h: float, y: Points) -> Array:
        node = h * np.sqrt(15.0) / 10.0
        a, b, c = (self._at(x, y) for x in (t - node, t, t + node))
        one, two = h * b, np.sqrt(15.0) / 3.0 * h * (c - a)
        three = 10.0 / 3.0 * h * (c - 2.0 * b + a)
        first = self._bracket(one, two)
        second = -self._bracket(one, 2.0 * three + first) / 60.0
        third = self._bracket(-20.0 * one - three + first, two + second)
        return np.asarray(one + three / 12.0 + third / 240.0)
