r"""Attitude control of a satellite by three reaction wheels along its principal axes [1]_.

With the unit quaternion :math:`q` (scalar last) from body axes to inertial ones, the angular
velocity :math:`\omega` and the momentum of the wheels :math:`h` in body axes,

.. math::

    q' = \tfrac12\, q \otimes \omega, \qquad
    I \omega' = (I\omega + h) \times \omega - u, \qquad h' = u, \qquad
    u = k_p \vec q + k_d\, \omega ,

where :math:`\vec q` is the vector part of :math:`q`: the feedback stabilises the identity at rest,
and transfers the angular momentum to the wheels. A point is the flat vector of
:math:`q, \omega, h`.

References
----------
.. [1] B. Wie, *Space Vehicle Dynamics and Control*, 2nd ed., AIAA, 2008, chapter 7.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cg import solve_ivp
from cg.frames import Euclidean, Product, UnitQuaternion

Array = NDArray[np.float64]

INERTIA = (1.0, 1.5, 2.0)  # principal moments, without those of the wheels about their axes (kg m²)
STIFFNESS, DAMPING = 2.0, 2.0  # gains of the feedback: k_p (N m) and k_d (N m s)

frame = Product(UnitQuaternion(), Euclidean(6))
attitude = np.array([0.5, -0.25, 0.75, 0.125])
y0 = frame.join(attitude / np.linalg.norm(attitude), [0.5, 1.0, -0.75, 0.0, 0.25, 0.5])


def f(t: float, y: Array) -> list[float]:
    """Return the angular velocity and the derivatives of velocity and wheels."""
    q1, q2, q3, _, w1, w2, w3, h1, h2, h3 = y.tolist()
    i1, i2, i3 = INERTIA
    kp, kd = STIFFNESS, DAMPING
    u1, u2, u3 = kp * q1 + kd * w1, kp * q2 + kd * w2, kp * q3 + kd * w3
    m1, m2, m3 = i1 * w1 + h1, i2 * w2 + h2, i3 * w3 + h3
    return [
        w1,
        w2,
        w3,
        (m2 * w3 - m3 * w2 - u1) / i1,
        (m3 * w1 - m1 * w3 - u2) / i2,
        (m1 * w2 - m2 * w1 - u3) / i3,
        u1,
        u2,
        u3,
    ]


def invariants(y: Array) -> dict[str, Array]:
    """Return the total angular momentum in inertial axes, shape ``(..., 3)``."""
    q, rest = frame.split(y)
    body = np.array(INERTIA) * rest[..., :3] + rest[..., 3:]
    # q v q* of a unit quaternion q = (a, w) is v + 2 a x (a x v + w v)
    axis, scalar = q[..., :3], q[..., 3:]
    change = 2.0 * np.cross(axis, np.cross(axis, body) + scalar * body)
    return {"angular momentum": body + change}


if __name__ == "__main__":
    solution = solve_ivp(f, (0, 40), y0, frame=frame, rtol=1e-8, atol=1e-8)
    momentum = invariants(solution.y)["angular momentum"]
    print("largest change of the angular momentum (N m s):", abs(momentum - momentum[0]).max())
