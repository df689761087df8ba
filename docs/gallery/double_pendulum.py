r"""Double spherical pendulum: a product of two spheres and the angular velocities of both rods.

With the directions :math:`q_i` of the rods, their angular velocities :math:`\omega_i \perp q_i`,
:math:`M_{11} = (m_1 + m_2) l_1^2`, :math:`M_{12} = m_2 l_1 l_2`, :math:`M_{22} = m_2 l_2^2`,
:math:`G_1 = (m_1 + m_2) g l_1` and :math:`G_2 = m_2 g l_2`,

.. math::

    q_i' = \omega_i \times q_i, \qquad
    M_{ii} \omega_i' - M_{ij} \hat q_i \hat q_j\, \omega_j'
    = M_{ij} |\omega_j|^2\, q_i \times q_j - G_i\, q_i \times e_3, \qquad j \ne i

[1]_. A point is the flat vector of :math:`q_1, q_2, \omega_1, \omega_2`.

References
----------
.. [1] T. Lee, M. Leok, N. H. McClamroch, "Lagrangian mechanics and variational integrators on
   two-spheres", Int. J. Numer. Meth. Eng. 79 (2009), 1147-1174.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cg import solve_ivp
from cg.frames import Euclidean, Product, Sphere, hat

Array = NDArray[np.float64]

M1, M2 = 1.0, 0.5  # masses (kg)
L1, L2 = 1.0, 0.75  # lengths of the rods (m)
GRAVITY = 9.81  # along -e_3 (m/s^2)
UP = np.array([0.0, 0.0, 1.0])

M11, M12, M22 = (M1 + M2) * L1**2, M2 * L1 * L2, M2 * L2**2
G1, G2 = (M1 + M2) * GRAVITY * L1, M2 * GRAVITY * L2

frame = Product(Sphere(2), Sphere(2), Euclidean(6))
y0 = np.array([0.6, 0.0, -0.8, 0.0, 0.8, -0.6, 0.48, 0.5, 0.36, -0.5, 0.24, 0.32])


def parts(y: Array) -> tuple[Array, Array, Array, Array]:
    """Return both directions and both angular velocities, each of shape ``(..., 3)``."""
    return y[..., 0:3], y[..., 3:6], y[..., 6:9], y[..., 9:12]


def f(t: float, y: Array) -> Array:
    """Return the angular velocities and their derivatives, shape ``(..., 12)``."""
    q1, q2, w1, w2 = parts(y)
    coupling = M12 * hat(q1) @ hat(q2)
    matrix = np.zeros((*q1.shape[:-1], 6, 6))
    matrix[..., :3, :3] = M11 * np.eye(3)
    matrix[..., 3:, 3:] = M22 * np.eye(3)
    matrix[..., :3, 3:] = -coupling
    matrix[..., 3:, :3] = -coupling.mT
    across = np.cross(q1, q2)
    first = M12 * np.vecdot(w2, w2)[..., None] * across - G1 * np.cross(q1, UP)
    second = -M12 * np.vecdot(w1, w1)[..., None] * across - G2 * np.cross(q2, UP)
    right = np.concatenate([first, second], axis=-1)[..., None]
    return np.concatenate([w1, w2, np.linalg.solve(matrix, right)[..., 0]], axis=-1)


def positions(y: Array) -> tuple[Array, Array]:
    """Return the positions of the masses (m), each of shape ``(..., 3)``."""
    q1, q2, _, _ = parts(y)
    return L1 * q1, L1 * q1 + L2 * q2


def invariants(y: Array) -> dict[str, Array]:
    """Return the energy (J), the vertical angular momentum (kg m²/s) and the rods' spin (rad/s)."""
    q1, q2, w1, w2 = parts(y)
    v1, v2 = np.cross(w1, q1), np.cross(w2, q2)
    kinetic = 0.5 * M11 * np.vecdot(v1, v1) + M12 * np.vecdot(v1, v2)
    kinetic += 0.5 * M22 * np.vecdot(v2, v2)
    momentum = np.cross(q1, M11 * v1 + M12 * v2) + np.cross(q2, M12 * v1 + M22 * v2)
    return {
        "energy": kinetic + G1 * q1[..., 2] + G2 * q2[..., 2],
        "vertical momentum": momentum[..., 2],
        "spin": np.stack([np.vecdot(q1, w1), np.vecdot(q2, w2)], axis=-1),
    }


if __name__ == "__main__":
    solution = solve_ivp(f, (0, 8), y0, frame=frame, rtol=1e-9, atol=1e-9)
    energy = invariants(solution.y)["energy"]
    print("masses at 8 s:", *positions(solution.y[-1]))
    print("largest change of energy:", abs(energy - energy[0]).max())
