"""The attitude of a spacecraft on a circular orbit, as a quaternion and an angular velocity."""

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

_FRAME = Product(UnitQuaternion(), Euclidean(3))


@dataclass(frozen=True)
class Spacecraft(QuadraticProblem):
    r"""A rigid spacecraft with gravity-gradient torque and attitude control.

    The unit quaternion :math:`q` (scalar last) maps body axes to orbit axes: the first orbit axis
    points away from the planet, the third along the orbit normal; the orbit rate is :math:`n`.
    With the directions :math:`r` and :math:`h` of these two in body axes,

    .. math::

        q' = \tfrac12\, q \otimes w, \quad w = \omega - n h, \qquad
        I \omega' = I\omega \times \omega + 3 n^2\, r \times I r - k_p \vec q - k_d w ,

    where :math:`\vec q` is the vector part of :math:`q`: the control aligns the two triads.

    A point is the flat vector of :math:`q` and of the angular velocity :math:`\omega` in body
    axes; `reference` adds the unknowns :math:`r` and :math:`h`.

    Parameters
    ----------
    inertia
        Principal moments of inertia (kg m²).
    orbit_rate
        :math:`n` (rad/s).
    stiffness, damping
        :math:`k_p` (N m) and :math:`k_d` (N m s) of the control, zero for none.
    attitude
        The quaternion at time zero, of any nonzero length.
    velocity
        Angular velocity at time zero (rad/s).

    Raises
    ------
    ValueError
        If a parameter has the wrong shape or isn't finite, the moments of inertia violate the
        triangle inequalities, or the quaternion vanishes.

    References
    ----------
    .. [1] J. R. Wertz (ed.), *Spacecraft Attitude Determination and Control*, Reidel, 1978,
       chapters 16 and 17.

    Examples
    --------
    Control aligns the spacecraft with its orbit:

    >>> import cg
    >>> problem = Spacecraft(stiffness=2.0, damping=3.0)
    >>> run = cg.solve_ivp(
    ...     problem.f, (0, 30), problem.y0, frame=problem.frame, rtol=1e-8, atol=1e-8
    ... )
    >>> abs(run.y[-1, :4]).round(4)
    array([0., 0., 0., 1.])
    """

    inertia: tuple[float, ...] = (1.0, 1.5, 2.0)
    orbit_rate: float = 1.0
    stiffness: float = 0.0
    damping: float = 0.0
    attitude: tuple[float, ...] = (0.25, -0.125, 0.5, 1.0)
    velocity: tuple[float, ...] = (0.25, -0.5, 1.5)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia", moments(self.inertia))
        for name in ("orbit_rate", "stiffness", "damping"):
            object.__setattr__(self, name, number(getattr(self, name), name))
        object.__setattr__(self, "attitude", vector(self.attitude, "attitude", 4))
        object.__setattr__(self, "velocity", vector(self.velocity, "velocity", 3))
        if not any(self.attitude):
            raise ValueError(f"attitude must not vanish, got {self.attitude!r}")

    @property
    def frame(self) -> Product:
        """``Product(UnitQuaternion(), Euclidean(3))``."""
        return _FRAME

    @property
    def y0(self) -> Array:
        """The initial point, shape ``(7,)``."""
        attitude = np.array(self.attitude)
        return self.frame.join(attitude / np.linalg.norm(attitude), self.velocity)

    def f(self, t: float, y: Array) -> Array:
        """Return the velocity relative to the orbit's axes, and the angular acceleration.

        Parameters
        ----------
        t
            Time; the equations don't depend on it.
        y
            Points, shape ``(..., 7)``.

        Returns
        -------
        ndarray
            Shape ``(..., 6)``.
        """
        q, omega = y[..., :4], y[..., 4:]
        inertia, n = np.array(self.inertia), self.orbit_rate
        r, h = _orbit_axes(q)
        relative = omega - n * h
        torque = np.cross(inertia * omega, omega) + 3.0 * n * n * np.cross(r, inertia * r)
        torque -= self.stiffness * q[..., :3] + self.damping * relative
        return np.concatenate([relative, torque / inertia], axis=-1)

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        r"""Return the energy in orbit axes, shape ``(...)``, which is constant without damping.

        It is :math:`\frac12 \omega^T I \omega - n h^T I \omega + \frac32 n^2 r^T I r +
        2 k_p (1 - q_4)`, Jacobi's integral with the potential of the control.
        """
        q, omega = self.frame.split(y)
        inertia, n = np.array(self.inertia), self.orbit_rate
        r, h = _orbit_axes(q)
        terms = 0.5 * omega * omega - n * h * omega + 1.5 * n * n * r * r
        control = 2.0 * self.stiffness * (1.0 - q[..., 3])
        return {"energy": np.asarray((inertia * terms).sum(axis=-1) + control)}

    def _initial(self) -> list[arb]:
        q = unit_vector(self.attitude)
        r, h = _rotation_rows(*q)
        return [*q, *map(ball, self.velocity), *r, *h]

    def _derivatives(self, y: Any) -> Any:
        # Unknowns: q, omega, r, h; the axes of the orbit turn as x' = x cross (omega - n h).
        q, omega, r, h = y[:4], y[4:7], y[7:10], y[10:]
        n, inertia = ball(self.orbit_rate), balls(self.inertia)
        relative = omega - n * h
        control = ball(self.stiffness) * q[:3] + ball(self.damping) * relative
        torque = np.cross(inertia * omega, omega) + 3 * n * n * np.cross(r, inertia * r) - control
        rates = [quaternion_rate(q, relative), torque * (1 / inertia)]
        return np.concatenate([*rates, np.cross(r, relative), np.cross(h, omega)])


def _orbit_axes(q: Array) -> tuple[Array, Array]:
    r, h = _rotation_rows(q[..., 0], q[..., 1], q[..., 2], q[..., 3])
    return np.stack(r, axis=-1), np.stack(h, axis=-1)


def _rotation_rows(x: Any, y: Any, z: Any, w: Any) -> tuple[list[Any], list[Any]]:
    """Return the first and third rows of the rotation matrix of a unit quaternion."""
    first = [w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)]
    third = [2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z]
    return first, third
