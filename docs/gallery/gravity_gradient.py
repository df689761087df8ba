r"""A satellite that librates in the gravity gradient of a circular orbit.

The direction :math:`r = q^T (\cos a, \sin a, 0)` of the planet in body axes depends on the attitude
q and on the orbit's angle a. The potential :math:`V = \tfrac32 r \cdot J r` has the torque
:math:`3\, r \times J r` on the body, and its component about the normal is taken from the orbit,
whose moment of inertia about the planet is much larger.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np

from cg.frames import SO3, Euclidean, PhaseSpace, Product

INERTIA, ORBIT = (1.0, 1.6, 2.3), 100.0
TURN = pi  # half an orbit, about the fastest libration

frame = PhaseSpace(Product(SO3(), Euclidean(1)), inertia=(INERTIA, ORBIT))
_attitude = SO3().flow([0.3, 0.2, 0.4], np.eye(3))
y0 = frame.join(np.append(_attitude, 0.0), [0.1, -0.2, 2.4, ORBIT])


def f(t: float, y: Any) -> list[float]:
    """Return the torque in body axes, and that on the orbit."""
    q1, q2, q3, q4, q5, q6, q7, q8, q9, a = y[:10].tolist()
    (i1, i2, i3), c, s = INERTIA, 3.0 * cos(a), 3.0 * sin(a)
    r1, r2, r3 = c * q1 + s * q4, c * q2 + s * q5, c * q3 + s * q6
    x, y_, z = (i3 - i2) * r2 * r3 / 3, (i1 - i3) * r3 * r1 / 3, (i2 - i1) * r1 * r2 / 3
    return [x, y_, z, -(q7 * x + q8 * y_ + q9 * z)]


def invariants(y: Any) -> dict[str, Any]:
    """Return the energy, and the angular momentum about the orbit's normal."""
    configuration, momentum = frame.split(y)
    q, a = configuration[..., :9].reshape(*y.shape[:-1], 3, 3), configuration[..., 9:]
    r = np.cos(a) * q[..., 0, :] + np.sin(a) * q[..., 1, :]
    return {
        "energy": frame.kinetic_energy(y) - ORBIT / 2 + 1.5 * r**2 @ np.array(INERTIA),
        "normal momentum": np.vecdot(q[..., 2, :], momentum[..., :3]) + momentum[..., 3] - ORBIT,
    }
