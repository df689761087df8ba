"""A two-level quantum system in a rotating field, with Rabi's closed solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.frames import SU
from cg.frames.arrays import Array
from cg.problems.checks import number, times_array


@dataclass(frozen=True)
class TwoLevelSystem:
    r"""The propagator of a spin 1/2 in a field that rotates about the third axis.

    .. math::

        U' = -i H(t)\, U, \qquad H = \tfrac12\, b \cdot \sigma, \qquad
        b = (\Omega \cos \omega t,\ \Omega \sin \omega t,\ \omega_0),

    in units with :math:`\hbar = 1`, with the Pauli matrices :math:`\sigma`.

    A point is the unitary matrix :math:`U`.

    Parameters
    ----------
    splitting
        :math:`\omega_0`, the difference of the energy levels (rad/s).
    coupling
        :math:`\Omega`, the Rabi frequency on resonance (rad/s).
    drive
        :math:`\omega`, the frequency of the field (rad/s).

    Raises
    ------
    ValueError
        If a parameter isn't a finite number.

    References
    ----------
    .. [1] I. I. Rabi, "Space quantization in a gyrating magnetic field", Phys. Rev. 51 (1937),
       652-654.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> problem = TwoLevelSystem()
    >>> run = cg.integrate(problem.f, (0, 3), problem.y0, frame=problem.frame, method="CF4", h=0.02)
    >>> np.allclose(abs(run.y[-1, 1, 0]) ** 2, problem.transition_probability(3.0), atol=1e-7)
    True
    """

    splitting: float = 2.0
    coupling: float = 1.0
    drive: float = 2.5

    def __post_init__(self) -> None:
        for name in ("splitting", "coupling", "drive"):
            object.__setattr__(self, name, number(getattr(self, name), name))

    @property
    def frame(self) -> SU:
        """``SU(2)``, whose coefficients are the field."""
        return SU(2)

    @property
    def y0(self) -> NDArray[np.complex128]:
        """The identity, shape ``(2, 2)``."""
        return np.eye(2, dtype=np.complex128)

    def f(self, t: float, y: NDArray[np.complex128]) -> Array:
        """Return the field, shape ``(3,)``; it depends on time alone."""
        phase = self.drive * t
        return np.array(
            [self.coupling * np.cos(phase), self.coupling * np.sin(phase), self.splitting]
        )

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return the norms of the columns, shape ``(..., 2)``, and the determinant, ``(...)``."""
        u = self.frame._points(y)
        return {
            "norms": np.asarray(np.linalg.norm(u, axis=-2)),
            "determinant": np.asarray(np.linalg.det(u)),
        }

    def exact(self, t: ArrayLike) -> NDArray[np.complex128]:
        r"""Return the propagator at given times, shape ``(..., 2, 2)``.

        In the frame that rotates with the field the Hamiltonian is constant:
        :math:`U = e^{-i \omega t \sigma_3 / 2} e^{-i t (\Delta \sigma_3 + \Omega \sigma_1) / 2}`
        with the detuning :math:`\Delta = \omega_0 - \omega`.
        """
        times = times_array(t)
        zeros = np.zeros_like(times)
        rotation = np.stack([zeros, zeros, self.drive * times], axis=-1)
        rest = np.stack(
            [self.coupling * times, zeros, (self.splitting - self.drive) * times], axis=-1
        )
        return np.asarray(self.frame.exponential(rotation) @ self.frame.exponential(rest))

    def transition_probability(self, t: ArrayLike) -> Array:
        """Return the probability of a transition at given times, by Rabi's formula."""
        times = times_array(t)
        detuning = self.splitting - self.drive
        square = detuning**2 + self.coupling**2
        if square == 0.0:
            return np.zeros_like(times)
        return np.asarray(self.coupling**2 / square * np.sin(0.5 * np.sqrt(square) * times) ** 2)
