"""Attitude control of a satellite by three reaction wheels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb
from numpy.typing import ArrayLike

from cg.frames import Euclidean, Product, UnitQuaternion
from cg.frames.arrays import Array
from cg.problems.checks import moments, number, vector
from cg.problems.quadratic import QuadraticProblem, balls, quaternion_rate, unit_vector
from cg.problems.taylor import ball

_FRAME = Product(UnitQuaternion(), Euclidean(6))


@dataclass(frozen=True)
class ReactionWheels(QuadraticProblem):
    r"""A satellite without external torques, controlled by wheels along its principal axes.

    With the unit quaternion :math:`q` (scalar last) from body axes to inertial ones, the angular
    velocity :math:`\omega` and the momentum of the wheels :math:`h` in body axes,

    .. math::

        q' = \tfrac12\, q \otimes \omega, \qquad
        I \omega' = (I\omega + h) \times \omega - u, \qquad h' = u, \qquad
        u = k_p \vec q + k_d\, \omega ,

    where :math:`\vec q` is the vector part of :math:`q`: the feedback stabilises the identity at
    rest, and transfers the angular momentum to the wheels.

    A point is the flat vector of :math:`q, \omega, h`.

    Parameters
    ----------
    inertia
        Principal moments of inertia, without those of the wheels about their axes (kg m²).
    stiffness, damping
        :math:`k_p` (N m) and :math:`k_d` (N m s) of the feedback.
    attitude
        The quaternion at time zero, of any nonzero length.
    velocity
        Angular velocity at time zero (rad/s).
    wheels
        The momentum of the wheels at time zero (N m s).

    Raises
    ------
    ValueError
        If a parameter has the wrong shape or isn't finite, the moments of inertia violate the
        triangle inequalities, or the quaternion vanishes.

    References
    ----------
    .. [1] B. Wie, *Space Vehicle Dynamics and Control*, 2nd ed., AIAA, 2008, chapter 7.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> problem = ReactionWheels()
    >>> run = cg.solve_ivp(
    ...     problem.f, (0, 40), problem.y0, frame=problem.frame, rtol=1e-8, atol=1e-8
    ... )
    >>> run.y[-1, 4:7].round(4) + 0.0
    array([ 0.    , -0.0001,  0.0004])
    >>> momentum = problem.invariants(run.y)["angular momentum"]
    >>> np.allclose(momentum, momentum[0], atol=1e-6)
    True
    """

    inertia: tuple[float, ...] = (1.0, 1.5, 2.0)
    stiffness: float = 2.0
    damping: float = 2.0
    attitude: tuple[float, ...] = (0.5, -0.25, 0.75, 0.125)
    velocity: tuple[float, ...] = (0.5, 1.0, -0.75)
    wheels: tuple[float, ...] = (0.0, 0.25, 0.5)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia", moments(self.inertia))
        for name in ("stiffness", "damping"):
            object.__setattr__(self, name, number(getattr(self, name), name))
        for name, n in (("attitude", 4), ("velocity", 3), ("wheels", 3)):
            object.__setattr__(self, name, vector(getattr(self, name), name, n))
        if not any(self.attitude):
            raise ValueError(f"attitude must not vanish, got {self.attitude!r}")

    @property
    def frame(self) -> Product:
        """``Product(UnitQuaternion(), Euclidean(6))``."""
        return _FRAME

    @property
    def y0(self) -> Array:
        """The initial point, shape ``(10,)``."""
        attitude = np.array(self.attitude)
        rest = (*self.velocity, *self.wheels)
        return self.frame.join(attitude / np.linalg.norm(attitude), rest)

    def f(self, t: float, y: Array) -> Array:
        """Return the angular velocity and the derivatives of velocity and wheels.

        Parameters
        ----------
        t
            Time; the equations don't depend on it.
        y
            Points, shape ``(..., 10)``.

        Returns
        -------
        ndarray
            Shape ``(..., 9)``.
        """
        omega, h = y[..., 4:7], y[..., 7:]
        inertia = np.array(self.inertia)
        torque = self.torque(y)
        change = np.cross(inertia * omega + h, omega) - torque
        return np.concatenate([omega, change / inertia, torque], axis=-1)

    def torque(self, y: Array) -> Array:
        """Return the torque :math:`u` of the motors on the wheels, shape ``(..., 3)``."""
        return np.asarray(self.stiffness * y[..., :3] + self.damping * y[..., 4:7])

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return the total angular momentum in inertial axes, shape ``(..., 3)``."""
        q, rest = self.frame.split(y)
        body = np.array(self.inertia) * rest[..., :3] + rest[..., 3:]
        # q v q* of a unit quaternion q = (a, w) is v + 2 a x (a x v + w v)
        axis, scalar = q[..., :3], q[..., 3:]
        change = 2.0 * np.cross(axis, np.cross(axis, body) + scalar * body)
        return {"angular momentum": body + change}

    def _initial(self) -> list[arb]:
        return [*unit_vector(self.attitude), *map(ball, (*self.velocity, *self.wheels))]

    def _derivatives(self, y: Any) -> Any:
        q, omega, h = y[:4], y[4:7], y[7:]
        inertia = balls(self.inertia)
        control = ball(self.stiffness) * q[:3] + ball(self.damping) * omega
        torque = np.cross(inertia * omega + h, omega) - control
        return [*quaternion_rate(q, omega), *(torque * (1 / inertia)), *control]
