r"""A heavy top with three moments of inertia, whose motion is chaotic.

With the vertical :math:`v = q^T e_3` and the centre of mass c, both in body axes, the potential is
:math:`V = w\, v \cdot c` and the torque :math:`w\, v \times c`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cg.frames import SO3, PhaseSpace

WEIGHT, CENTRE = 1.2, (0.1, 0.2, 0.9)
TURN = 3.5  # rate of the top about its own axis

frame = PhaseSpace(SO3(), inertia=[1.0, 1.6, 2.3])
y0 = frame.join(SO3().flow([0.4, 0.2, 0.0], np.eye(3)), [0.3, 0.4, 4.0])


def f(t: float, y: Any) -> list[float]:
    """Return the torque of the weight in body axes."""
    v1, v2, v3 = y[6:9].tolist()
    c1, c2, c3 = CENTRE
    return [
        WEIGHT * (v2 * c3 - v3 * c2),
        WEIGHT * (v3 * c1 - v1 * c3),
        WEIGHT * (v1 * c2 - v2 * c1),
    ]


def invariants(y: Any) -> dict[str, Any]:
    """Return the energy, and the angular momentum about the vertical."""
    q, momentum = frame.split(y)
    vertical = q[..., 2, :]
    return {
        "energy": frame.kinetic_energy(y) + WEIGHT * vertical @ np.array(CENTRE),
        "vertical momentum": np.vecdot(vertical, momentum),
    }
