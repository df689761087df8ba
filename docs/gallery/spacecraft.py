r"""A spacecraft on a circular orbit, with gravity-gradient torque and attitude control [1]_.

The unit quaternion :math:`q` (scalar last) maps body axes to orbit axes: the first orbit axis
points away from the planet, the third along the orbit normal; the orbit rate is :math:`n`. With
the directions :math:`r` and :math:`h` of these two in body axes,

.. math::

    q' = \tfrac12\, q \otimes w, \quad w = \omega - n h, \qquad
    I \omega' = I\omega \times \omega + 3 n^2\, r \times I r - k_p \vec q - k_d w ,

where :math:`\vec q` is the vector part of :math:`q`: the control aligns the two triads. A point is
the flat vector of :math:`q` and of the angular velocity :math:`\omega` in body axes.

References
----------
.. [1] J. R. Wertz (ed.), *Spacecraft Attitude Determination and Control*, Reidel, 1978, chapters
   16 and 17.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cg import solve_ivp
from cg.frames import Euclidean, Product, UnitQuaternion

Array = NDArray[np.float64]

INERTIA = (1.0, 1.5, 2.0)  # principal moments (kg m²)
ORBIT_RATE = 1.0  # n (rad/s)
STIFFNESS, DAMPING = 1.0, 1.0  # gains of the control: k_p (N m) and k_d (N m s)

frame = Product(UnitQuaternion(), Euclidean(3))
attitude = np.array([0.25, -0.125, 0.5, 1.0])
y0 = frame.join(attitude / np.linalg.norm(attitude), [0.25, -0.5, 1.5])


def orbit_axes(x: float, y: float, z: float, w: float) -> tuple[list[float], list[float]]:
    """Return the first and third rows of the rotation matrix of a unit quaternion: r and h."""
    r = [w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)]
    h = [2 * (x * z - y * w), 2 * (y * z + x * w), w * w + z * z - x * x - y * y]
    return r, h


def f(t: float, y: Array) -> list[float]:
    """Return the velocity relative to the orbit's axes, and the angular acceleration."""
    q1, q2, q3, q4, w1, w2, w3 = y.tolist()
    (i1, i2, i3), n = INERTIA, ORBIT_RATE
    (r1, r2, r3), (h1, h2, h3) = orbit_axes(q1, q2, q3, q4)
    pull, kp, kd = 3.0 * n * n, STIFFNESS, DAMPING
    u1, u2, u3 = w1 - n * h1, w2 - n * h2, w3 - n * h3
    return [
        u1,
        u2,
        u3,
        ((i2 - i3) * (w2 * w3 - pull * r2 * r3) - kp * q1 - kd * u1) / i1,
        ((i3 - i1) * (w3 * w1 - pull * r3 * r1) - kp * q2 - kd * u2) / i2,
        ((i1 - i2) * (w1 * w2 - pull * r1 * r2) - kp * q3 - kd * u3) / i3,
    ]


def energy(y: Array) -> float:
    r"""Return the energy in orbit axes, which decreases, and is constant without damping.

    It is :math:`\frac12 \omega^T I \omega - n h^T I \omega + \frac32 n^2 r^T I r +
    2 k_p (1 - q_4)`, Jacobi's integral with the potential of the control.
    """
    omega, n = y[4:], ORBIT_RATE
    r, h = map(np.array, orbit_axes(*y[:4].tolist()))
    terms = 0.5 * omega * omega - n * h * omega + 1.5 * n * n * r * r
    return float(np.array(INERTIA) @ terms + 2.0 * STIFFNESS * (1.0 - y[3]))


if __name__ == "__main__":
    solution = solve_ivp(f, (0, 30), y0, frame=frame, rtol=1e-8, atol=1e-8)
    print("quaternion and angular velocity at the end:", solution.y[-1].round(4))
