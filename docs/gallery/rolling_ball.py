r"""A homogeneous ball that rolls without slipping on a turntable, an example of [1]_.

In space axes, with the attitude :math:`R`, the angular velocity :math:`\omega`, the centre
:math:`x` of the ball over the table, its velocity :math:`v`, the radius :math:`r` and the rate
:math:`\Omega` of the table,

.. math::

    R' = \hat\omega R, \qquad \omega' = \tfrac{5 \Omega}{7 r}\, v, \qquad
    x' = v = \Omega\, e_3 \times x + r\, \omega \times e_3 .

The last equation is the constraint that the point of contact moves with the table. The centre
moves on a circle, :math:`v' = \tfrac27 \Omega\, e_3 \times v` [2]_. A point is the flat vector of
:math:`R` (row by row), :math:`\omega` and the two coordinates of :math:`x`.

References
----------
.. [1] P. E. Crouch, R. Grossman, "Numerical integration of ordinary differential equations
   on manifolds", J. Nonlinear Sci. 3 (1993), 1-33.
.. [2] K. Weltner, "Stable circular orbits of freely moving balls on rotating discs",
   Am. J. Phys. 47 (1979), 984-986.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cg import solve_ivp
from cg.frames import SO3, Euclidean, Product

Array = NDArray[np.float64]

RATE = 2.0  # rate of the table (rad/s)
RADIUS = 0.5  # radius of the ball (m)

frame = Product(SO3("space"), Euclidean(5))
y0 = frame.join(np.eye(3), [0.5, -1.0, 1.5, 1.0, 0.25])


def velocity(y: Array) -> Array:
    """Return the velocity of the centre (m/s), shape ``(..., 2)``."""
    omega, x = y[..., 9:12], y[..., 12:]
    return np.stack(
        [-RATE * x[..., 1] + RADIUS * omega[..., 1], RATE * x[..., 0] - RADIUS * omega[..., 0]],
        axis=-1,
    )


def f(t: float, y: Array) -> Array:
    """Return the angular velocity, its derivative, and the velocity, shape ``(..., 8)``."""
    omega, v = y[..., 9:12], velocity(y)
    acceleration = np.zeros_like(omega)
    acceleration[..., :2] = 5.0 * RATE / (7.0 * RADIUS) * v
    return np.concatenate([omega, acceleration, v], axis=-1)


def exact_position(t: Array) -> Array:
    """Return the centre over the table at given times, shape ``(..., 2)``."""
    x, v = complex(*y0[12:]), complex(*velocity(y0))
    rate = 2.0 * RATE / 7.0
    # The mean of exp(i rate s) for s from 0 to t
    mean = np.exp(0.5j * rate * t) * np.sinc(0.5 * rate * t / np.pi)
    z = x + v * t * mean
    return np.stack([z.real, z.imag], axis=-1)


def invariants(y: Array) -> dict[str, Array]:
    r"""Return the spin, the speed, and the horizontal part of :math:`\omega - 5\Omega x/(7r)`."""
    factor = 5.0 * RATE / (7.0 * RADIUS)
    return {
        "spin": y[..., 11],
        "speed": np.linalg.norm(velocity(y), axis=-1),
        "turn over place": y[..., 9:11] - factor * y[..., 12:],
    }


if __name__ == "__main__":
    solution = solve_ivp(f, (0, 12), y0, frame=frame, rtol=1e-9, atol=1e-9)
    error = abs(solution.y[:, 12:] - exact_position(solution.t)).max()
    print("largest error of the position (m):", error)
