r"""A rigid body that turns about a fixed point, with a spherical pendulum attached to it.

The body has the attitude :math:`R` and in body axes the angular velocity :math:`\Omega`, its
centre of mass :math:`c` and the joint :math:`\rho` of the pendulum. The pendulum has the direction
:math:`q` and in space axes the angular velocity :math:`\omega \perp q`. With the force
:math:`\lambda q` of the rod on the body, the masses :math:`M, m` and the rod's length :math:`l`,

.. math::

    R' = R\, \hat\Omega, \qquad
    I \Omega' = I\Omega \times \Omega + \lambda\, \rho \times R^T q - M g\, c \times R^T e_3,

    q' = \omega \times q, \qquad
    l\, \omega' = -q \times (a + g e_3), \qquad
    \lambda = m\, (l |\omega|^2 - q \cdot (a + g e_3)) ,

where :math:`a = R(\Omega' \times \rho + \Omega \times (\Omega \times \rho))` is the acceleration
of the joint; see [1]_, chapter 9. A point is the flat vector of :math:`R` (row by row),
:math:`q`, :math:`\Omega` and :math:`\omega`.

References
----------
.. [1] T. Lee, M. Leok, N. H. McClamroch, *Global Formulations of Lagrangian and Hamiltonian
   Dynamics on Manifolds*, Springer, 2018.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cg import solve_ivp
from cg.frames import SO3, Euclidean, Product, Sphere

Array = NDArray[np.float64]

INERTIA = np.array([1.0, 1.25, 0.75])  # about the fixed point (kg m^2)
BODY_MASS, MASS = 1.0, 0.5  # masses of the body and of the pendulum (kg)
CENTRE = np.array([0.125, 0.0, -0.5])  # (m)
JOINT = np.array([0.25, 0.125, -1.0])  # (m)
LENGTH = 0.75  # length of the rod (m)
GRAVITY = 9.81  # along -e_3 (m/s^2)

frame = Product(SO3(), Sphere(2), Euclidean(6))
y0 = frame.join(np.eye(3), np.array([0.6, 0.0, -0.8]), [0.5, -1.0, 0.25, 0.48, 0.5, 0.36])


def parts(y: Array) -> tuple[Array, Array, Array, Array]:
    """Return the attitude, the direction of the rod, and the angular velocities of both."""
    attitude, q, velocities = frame.split(y)
    return attitude, q, velocities[..., :3], velocities[..., 3:]


def f(t: float, y: Array) -> Array:
    """Return both angular velocities, and their derivatives, shape ``(..., 12)``."""
    attitude, q, body, rod = parts(y)
    q_body, up = (attitude.mT @ q[..., None])[..., 0], attitude[..., 2, :]
    # Acceleration of the joint plus g e_3, in body axes, without the part that Omega' causes
    partial = np.cross(body, np.cross(body, JOINT)) + GRAVITY * up
    tension = MASS * (LENGTH * np.vecdot(rod, rod) - np.vecdot(q_body, partial))
    arm = np.cross(JOINT, q_body)
    torque = np.cross(INERTIA * body, body) - BODY_MASS * GRAVITY * np.cross(CENTRE, up)
    torque += tension[..., None] * arm
    # Solve (I + m arm arm^T) Omega' = torque by the Sherman-Morrison formula.
    free, direction = torque / INERTIA, arm / INERTIA
    factor = MASS * np.vecdot(arm, free) / (1.0 + MASS * np.vecdot(arm, direction))
    acceleration = free - factor[..., None] * direction
    joint = (attitude @ (partial + np.cross(acceleration, JOINT))[..., None])[..., 0]
    return np.concatenate([body, rod, acceleration, -np.cross(q, joint) / LENGTH], axis=-1)


def positions(y: Array) -> tuple[Array, Array]:
    """Return the positions of the joint and of the pendulum's mass (m), each ``(..., 3)``."""
    attitude, q, _, _ = parts(y)
    return attitude @ JOINT, attitude @ JOINT + LENGTH * q


def invariants(y: Array) -> dict[str, Array]:
    """Return the energy (J), the vertical angular momentum (kg m²/s) and the rod's spin (rad/s)."""
    attitude, q, body, rod = parts(y)
    mass = positions(y)[1]
    velocity = (attitude @ np.cross(body, JOINT)[..., None])[..., 0] + LENGTH * np.cross(rod, q)
    kinetic = 0.5 * (np.vecdot(INERTIA * body, body) + MASS * np.vecdot(velocity, velocity))
    height = (attitude @ CENTRE)[..., 2]
    momentum = (attitude @ (INERTIA * body)[..., None])[..., 0] + MASS * np.cross(mass, velocity)
    return {
        "energy": kinetic + GRAVITY * (BODY_MASS * height + MASS * mass[..., 2]),
        "vertical momentum": momentum[..., 2],
        "spin": np.vecdot(q, rod),
    }


if __name__ == "__main__":
    solution = solve_ivp(f, (0, 5), y0, frame=frame, rtol=1e-9, atol=1e-9)
    energy = invariants(solution.y)["energy"]
    print("joint and mass at 5 s:", *positions(solution.y[-1]))
    print("largest change of energy:", abs(energy - energy[0]).max())
