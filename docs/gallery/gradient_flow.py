r"""The gradient flow of a lattice gauge field, with a matrix in SU(3) on each link [1]_.

Each link :math:`V_\mu(x)` from the site :math:`x` to the next site along the axis :math:`\mu` of a
periodic lattice is a matrix in SU(3). The links follow the gradient of the Wilson action,

.. math::

    V_\mu' = Z_\mu V_\mu, \qquad
    Z_\mu = -\tfrac12 (P_\mu - P_\mu^*) + \tfrac16 \operatorname{tr}(P_\mu - P_\mu^*), \qquad
    S = \sum_{p} \operatorname{Re} \operatorname{tr} (1 - V_p),

where :math:`P_\mu(x)` is the sum over the :math:`2(d - 1)` oriented plaquettes :math:`V_p` that
begin with the link, and the sum in :math:`S` is over all plaquettes. Time is in units of the
square of the lattice spacing. A point has one matrix per link, shape ``(links, 3, 3)``, first all
links along the first axis; sites are counted in C order.

References
----------
.. [1] M. Lüscher, "Properties and uses of the Wilson flow in lattice QCD", JHEP 08 (2010) 071.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg import integrate
from cg.frames import SU, Power

Links = NDArray[np.complex128]
GROUP = SU(3)
# For a basis with tr(B_j* B_k) = delta_jk / 2, tr(B_k* M) is half the coefficient of the traceless
# anti-Hermitian part of M.
ADJOINTS = GROUP.basis.reshape(8, 9).conj().T.copy()


@dataclass(frozen=True)
class GradientFlow:
    """The flow on a lattice with a given number of sites along each axis, for two or more axes.

    The initial links are exponentials of normal coefficients with the standard deviation
    `roughness`.
    """

    sides: tuple[int, ...] = (2, 2)
    roughness: float = 0.5
    seed: int = 0

    @cached_property
    def frame(self) -> Power:
        """A copy of SU(3) for each link."""
        return Power(GROUP, len(self.sides) * prod(self.sides))

    @cached_property
    def y0(self) -> Links:
        """The links at time zero."""
        vectors = GROUP.random_vector(np.random.default_rng(self.seed), self.frame.n)
        return GROUP.restore(GROUP.exponential(self.roughness * vectors))

    @cached_property
    def neighbours(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """For each axis the sites one step ahead and one step behind of all sites."""
        sites = np.arange(prod(self.sides)).reshape(self.sides)
        axes = range(sites.ndim)
        return [(np.roll(sites, -1, k).ravel(), np.roll(sites, 1, k).ravel()) for k in axes]

    def loops(self, y: Links) -> Links:
        """Return for each link the sum of the plaquettes that begin with it, shape of ``y``."""
        links = y.reshape(len(self.sides), -1, 3, 3)
        adjoints = links.mT.conj()
        staples = np.zeros_like(links)
        for along, across in permutations(range(len(self.sides)), 2):
            (next_along, _), (next_across, previous) = (
                self.neighbours[along],
                self.neighbours[across],
            )
            forward = links[across, next_along] @ adjoints[along, next_across]
            back = adjoints[across, next_along] @ (adjoints[along] @ links[across])
            staples[along] += forward @ adjoints[across] + back[previous]
        return (links @ staples).reshape(y.shape)

    def f(self, t: float, y: Links) -> NDArray[np.float64]:
        r"""Return the coefficients of :math:`Z_\mu` for all links, shape ``(8 * links,)``."""
        return -2.0 * (self.loops(y).reshape(-1, 9) @ ADJOINTS).real.ravel()

    def action(self, y: Links) -> float:
        """Return the Wilson action per plaquette, which decreases along the flow."""
        # The sum over links counts each plaquette four times.
        plaquettes = self.frame.n * (len(self.sides) - 1) / 2
        trace = np.trace(self.loops(y), axis1=-2, axis2=-1).real.sum() / 4.0
        return 3.0 - float(trace) / plaquettes

    def invariants(self, y: Links) -> dict[str, Any]:
        """Return the determinants of the links, shape ``(..., links)``, which are one."""
        return {"determinant": np.linalg.det(y)}


if __name__ == "__main__":
    field = GradientFlow((4, 4))
    solution = integrate(field.f, (0, 1), field.y0, frame=field.frame, method="CF3b", h=0.02)
    print("action per plaquette:", field.action(field.y0), "→", field.action(solution.y[-1]))
