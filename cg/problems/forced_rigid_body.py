"""A rigid body with its attitude under a torque that varies with time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames import SO3, Euclidean, Product
from cg.problems.quadratic import QuadraticProblem, balls, identity, moments, number, vector
from cg.support import flint
from cg.support.arrays import Array
from cg.support.balls import to_ball


@dataclass(frozen=True)
class ForcedRigidBody(QuadraticProblem):
    r"""A rigid body under a torque that rotates with a given frequency.

    .. math::

        R' = R\, \hat\omega, \qquad I \omega' = I\omega \times \omega + \tau(t), \qquad
        \tau(t) = a \cos \nu t + b \sin \nu t ,

    in body axes; with :math:`a = b = 0` the body is free. A point is the flat vector of the
    rotation matrix :math:`R`, row by row, and :math:`\omega`; `reference` adds the unknowns
    :math:`\cos \nu t` and :math:`\sin \nu t`.

    Parameters
    ----------
    inertia
        Principal moments of inertia (kg m²), each at most the sum of the others.
    cosine, sine
        The torques :math:`a` and :math:`b` (N m).
    frequency
        :math:`\nu` (rad/s).
    velocity
        Angular velocity at time zero (rad/s).

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> problem = ForcedRigidBody(frequency=2.0)
    >>> problem.torque(0.0)
    array([ 0.5  , -0.25 ,  0.125])
    >>> run = cg.integrate(problem.f, (0, 2), problem.y0, frame=problem.frame, method="CF4", h=0.02)
    >>> bool(abs(problem.invariants(run.y)["determinant"] - 1).max() < 1e-14)
    True
    """

    inertia: tuple[float, ...] = (1.0, 1.5, 2.0)
    cosine: tuple[float, ...] = (0.5, -0.25, 0.125)
    sine: tuple[float, ...] = (-0.25, 0.5, 0.25)
    frequency: float = 1.0
    velocity: tuple[float, ...] = (0.5, -1.0, 0.75)

    frame = Product(SO3(), Euclidean(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia", moments(self.inertia))
        object.__setattr__(self, "frequency", number(self.frequency, "frequency"))
        for name in ("cosine", "sine", "velocity"):
            object.__setattr__(self, name, vector(getattr(self, name), name, 3))

    @property
    def y0(self) -> Array:
        """The identity and the initial angular velocity, shape ``(12,)``."""
        return self.frame.join(np.eye(3), np.array(self.velocity))

    def f(self, t: float, y: Array) -> list[float]:
        """Return the angular velocity and its derivative at a point, shape ``(12,)``."""
        i1, i2, i3 = self.inertia
        (a1, a2, a3), (b1, b2, b3), nu = self.cosine, self.sine, self.frequency
        w1, w2, w3 = y[9:].tolist()
        c, s = math.cos(nu * t), math.sin(nu * t)
        return [
            w1,
            w2,
            w3,
            ((i2 - i3) * w2 * w3 + a1 * c + b1 * s) / i1,
            ((i3 - i1) * w3 * w1 + a2 * c + b2 * s) / i2,
            ((i1 - i2) * w1 * w2 + a3 * c + b3 * s) / i3,
        ]

    def torque(self, t: float) -> Array:
        """Return the torque at a time, shape ``(3,)``."""
        phase = self.frequency * t
        return np.asarray(
            np.cos(phase) * np.array(self.cosine) + np.sin(phase) * np.array(self.sine)
        )

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return the determinant of the rotation, shape ``(...)``, which is one."""
        return {"determinant": np.asarray(np.linalg.det(self.frame.split(y)[0]))}

    def _initial(self) -> list[flint.arb]:
        return [*identity(), *map(to_ball, self.velocity), flint.arb(1), flint.arb(0)]

    def _derivatives(self, y: Any) -> Any:
        # Unknowns: R, omega, cos(nu t), sin(nu t)
        rotation, omega, cosine, sine = y[:9].reshape(3, 3), y[9:12], y[12], y[13]
        inertia, nu = balls(self.inertia), to_ball(self.frequency)
        torque = cosine * balls(self.cosine) + sine * balls(self.sine)
        change = (np.cross(inertia * omega, omega) + torque) * (1 / inertia)
        attitude_rate = np.cross(rotation, omega).ravel()
        return [*attitude_rate, *change, -nu * sine, nu * cosine]
