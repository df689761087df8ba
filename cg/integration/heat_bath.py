"""The heat bath of mechanical systems, whose noise compiled code draws."""

from __future__ import annotations

from dataclasses import dataclass
from secrets import randbits

from cg.support.checks import check_integer, check_real


@dataclass(frozen=True)
class Langevin:
    r"""A heat bath: friction and noise of the momenta of a `cg.frames.PhaseSpace`.

    With the inertia J, momenta :math:`\mu` and Brownian motions W, Langevin's equation is

    .. math::

        d\mu = (\dots)\,dt - \gamma \mu\,dt + \sqrt{2 \gamma T J}\,dW .

    Its equilibrium has the probability :math:`\propto e^{-H / T}`. A symmetric splitting method
    lets the momenta exchange heat in the middle of each step, where friction and noise alone are
    solved exactly: ``"Leapfrog"`` takes half a kick, half a drift, noise, half a drift and half a
    kick [1]_. Averages have errors of order two in the step size. With joints, ``"RATTLE"`` and its
    compositions do the same, and neither momenta nor noise open the joints.

    The noise is a function of the seed, of the member of an ensemble, and of the time of the step
    divided by its size [2]_. Workers, pickles and interruptions don't change it; a restart at an
    earlier time meets the same noise again, and so do two runs from one initial time with one seed.

    Parameters
    ----------
    friction
        The rate :math:`\gamma` at which momenta decay, not negative.
    temperature
        The temperature T times Boltzmann's constant, an energy, not negative.
    seed
        A number from 0 to 2**63 - 1, by default a random one.

    References
    ----------
    .. [1] B. Leimkuhler, C. Matthews, "Rational construction of stochastic numerical methods for
       molecular sampling", Appl. Math. Res. Express 2013, 34-56.
    .. [2] J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as
       1, 2, 3", SC11 (2011).

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.PhaseSpace(cg.frames.SO3(), [1.0, 1.6, 2.3])
    >>> y0 = np.tile(frame.join(np.eye(3), np.zeros(3)), (2000, 1))
    >>> solution = cg.solve_ensemble(
    ...     lambda t, y: np.zeros((len(y), 3)), (0, 8), y0, frame=frame, method="Leapfrog", h=0.5,
    ...     vectorized=True, thermostat=cg.Langevin(friction=1.0, temperature=0.7, seed=1),
    ... )
    >>> bool(abs(frame.kinetic_energy(solution.y[-1]).mean() - 1.5 * 0.7) < 0.06)
    True
    """

    friction: float
    temperature: float
    seed: int | None = None

    def __post_init__(self) -> None:
        for name in ("friction", "temperature"):
            object.__setattr__(self, name, check_real(name, getattr(self, name)))
        seed = randbits(63) if self.seed is None else check_integer("seed", self.seed, 0, 2**63 - 1)
        object.__setattr__(self, "seed", seed)
