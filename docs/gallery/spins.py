r"""Four classical spins without damping, :math:`s_i' = s_i \times \partial H / \partial s_i`.

The energy :math:`H = \sum_i (s_i \cdot D s_{i+1} + \tfrac12 (s_i \cdot e_3)^2 + b\, s_i \cdot e_3)`
of a ring has no kinetic part. As the field of the ambient space, at directions :math:`s/|s|`, it
is integrated by symplectic methods: sequences of midpoint steps, which keep lengths [1]_.

References
----------
.. [1] R. I. McLachlan, K. Modin, O. Verdier, "Symplectic integrators for spin systems", Phys. Rev.
   E 89 (2014) 061301.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cg.frames import Euclidean, Power, Sphere

COUPLING, FIELD = np.array([1.0, 1.0, 0.4]), 0.5
TURN = 4.0

frame, ambient = Power(Sphere(2), 4), Euclidean(12)
y0 = np.array([[2.0, 1.0, 2.0], [-6.0, 2.0, 3.0], [1.0, -4.0, 8.0], [-2.0, -6.0, 3.0]])
y0 /= np.linalg.norm(y0, axis=1, keepdims=True)


def gradient(s: Any) -> Any:
    """Return the derivatives of the energy."""
    neighbours = s[..., [1, 2, 3, 0], :] + s[..., [3, 0, 1, 2], :]
    return COUPLING * neighbours + np.array([0.0, 0.0, 1.0]) * (s + FIELD)


def f(t: float, s: Any) -> Any:
    """Return the rotation vectors of the spins."""
    return -gradient(s).ravel()


def in_ambient_space(t: float, y: Any) -> Any:
    """Return the derivatives of vectors of any length, those of their directions."""
    s = y.reshape(4, 3)
    s = s / np.sqrt(np.sum(s * s, axis=1))[:, None]
    g = gradient(s)
    return (s[:, [1, 2, 0]] * g[:, [2, 0, 1]] - s[:, [2, 0, 1]] * g[:, [1, 2, 0]]).ravel()


def invariants(s: Any) -> dict[str, Any]:
    """Return the energy and the sum of third components."""
    up = s[..., 2]
    pairs = (s * COUPLING * s[..., [1, 2, 3, 0], :]).sum(axis=(-2, -1))
    return {"energy": pairs + (up**2 / 2 + FIELD * up).sum(axis=-1), "momentum": up.sum(axis=-1)}
