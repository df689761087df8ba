r"""The propagator of a spin 1/2 in a field that rotates about the third axis [1]_.

.. math::

    U' = -i H(t)\, U, \qquad H = \tfrac12\, b \cdot \sigma, \qquad
    b = (\Omega \cos \omega t,\ \Omega \sin \omega t,\ \omega_0),

in units with :math:`\hbar = 1`, with the Pauli matrices :math:`\sigma`. A point is the unitary
matrix :math:`U`.

References
----------
.. [1] I. I. Rabi, "Space quantization in a gyrating magnetic field", Phys. Rev. 51 (1937), 652-654.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cg import solve_ivp
from cg.frames import SU

SPLITTING = 2.0  # difference of the energy levels (rad/s)
COUPLING = 1.0  # Rabi frequency on resonance (rad/s)
DRIVE = 2.5  # frequency of the field (rad/s)

frame = SU(2)
y0 = np.eye(2, dtype=np.complex128)


def f(t: float, y: NDArray[np.complex128]) -> list[float]:
    """Return the field, which depends on time alone."""
    return [COUPLING * math.cos(DRIVE * t), COUPLING * math.sin(DRIVE * t), SPLITTING]


def exact(t: float) -> NDArray[np.complex128]:
    r"""Return the propagator at a time, shape ``(2, 2)``.

    In the frame that rotates with the field the Hamiltonian is constant:
    :math:`U = e^{-i \omega t \sigma_3 / 2} e^{-i t (\Delta \sigma_3 + \Omega \sigma_1) / 2}` with
    the detuning :math:`\Delta = \omega_0 - \omega`.
    """
    rotation = frame.exponential([0.0, 0.0, DRIVE * t])
    return rotation @ frame.exponential([COUPLING * t, 0.0, (SPLITTING - DRIVE) * t])


def transition_probability(t: float) -> float:
    """Return the probability of a transition at a time, by Rabi's formula."""
    frequency = math.hypot(SPLITTING - DRIVE, COUPLING)
    return (COUPLING / frequency * math.sin(0.5 * frequency * t)) ** 2


def invariants(y: NDArray[np.complex128]) -> dict[str, NDArray[np.complex128]]:
    """Return the determinant, shape ``(...)``, which is one."""
    return {"determinant": np.linalg.det(y)}


if __name__ == "__main__":
    solution = solve_ivp(f, (0, 4), y0, frame=frame, rtol=1e-10, atol=1e-10)
    print("probability of a transition:", abs(solution.y[-1, 1, 0]) ** 2)
    print("by Rabi's formula:          ", transition_probability(4.0))
