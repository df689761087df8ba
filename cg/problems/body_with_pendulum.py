"""A chain of a rigid body and a pendulum: a rotation, a direction and their velocities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cg.frames import SO3, Euclidean, Product, Sphere
from cg.frames.arrays import Array
from cg.problems.ambient import ambient_solution
from cg.problems.checks import moments, number, vector

_FRAME = Product(SO3(), Sphere(2), Euclidean(6))
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class BodyWithPendulum:
    r"""A rigid body that turns about a fixed point, with a spherical pendulum hung from it.

    The body has the attitude :math:`R` and in body axes the angular velocity :math:`\Omega`, its
    centre of mass :math:`c` and the place :math:`\rho` where the pendulum hangs.  The pendulum
    has the direction :math:`q` and in space axes the angular velocity :math:`\omega \perp q`.
    With the force :math:`\lambda q` of the rod on the body, the mass :math:`m` and the rod's
    length :math:`l`,

    .. math::

        R' = R\, \hat\Omega, \qquad
        I \Omega' = I\Omega \times \Omega + \lambda\, \rho \times R^T q - M g\, c \times R^T e_3,

        q' = \omega \times q, \qquad
        l\, \omega' = -q \times (a + g e_3), \qquad
        \lambda = m\, (l |\omega|^2 - q \cdot (a + g e_3)) ,

    where :math:`a = R(\Omega' \times \rho + \Omega \times (\Omega \times \rho))` is the
    acceleration of the place that the pendulum hangs from.

    A point is the flat vector of :math:`R` (row by row), :math:`q`, :math:`\Omega` and
    :math:`\omega`.

    Parameters
    ----------
    inertia
        Principal moments of inertia of the body about the fixed point (kg m²).
    masses
        :math:`M` and :math:`m` (kg).
    centre, joint
        :math:`c` and :math:`\rho` (m).
    length
        :math:`l` (m).
    gravity
        :math:`g` (m/s²), along :math:`-e_3`.
    direction
        The pendulum at time zero, of any length but zero; the body begins at the identity.
    velocities
        :math:`\Omega` and :math:`\omega` at time zero (rad/s), six numbers; what is along the
        rod is left out.

    Raises
    ------
    ValueError
        If a parameter isn't as many finite numbers, a mass or the length isn't positive, no body
        has these moments, or the direction vanishes.

    References
    ----------
    .. [1] T. Lee, M. Leok, N. H. McClamroch, *Global Formulations of Lagrangian and Hamiltonian
       Dynamics on Manifolds*, Springer, 2018, chapter 9.

    Examples
    --------
    >>> import cg
    >>> problem = BodyWithPendulum()
    >>> run = cg.solve_ivp(problem.f, (0, 1), problem.y0, frame=problem.frame, rtol=1e-9, atol=1e-9)
    >>> energy = problem.invariants(run.y)["energy"]
    >>> bool(abs(energy - energy[0]).max() < 1e-7)
    True
    """

    inertia: tuple[float, ...] = (1.0, 1.25, 0.75)
    masses: tuple[float, ...] = (1.0, 0.5)
    centre: tuple[float, ...] = (0.125, 0.0, -0.5)
    joint: tuple[float, ...] = (0.25, 0.125, -1.0)
    length: float = 0.75
    gravity: float = 9.81
    direction: tuple[float, ...] = (0.6, 0.0, -0.8)
    velocities: tuple[float, ...] = (0.5, -1.0, 0.25, 0.0, 0.5, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia", moments(self.inertia))
        sizes = (("masses", 2), ("centre", 3), ("joint", 3), ("direction", 3), ("velocities", 6))
        for name, n in sizes:
            object.__setattr__(self, name, vector(getattr(self, name), name, n))
        object.__setattr__(self, "length", number(self.length, "length", positive=True))
        object.__setattr__(self, "gravity", number(self.gravity, "gravity"))
        if min(self.masses) <= 0.0:
            raise ValueError(f"masses must be positive, got {self.masses!r}")
        if not any(self.direction):
            raise ValueError(f"direction must not vanish, got {self.direction!r}")

    @property
    def frame(self) -> Product:
        """``Product(SO3(), Sphere(2), Euclidean(6))``."""
        return _FRAME

    @property
    def y0(self) -> Array:
        """The initial point, shape ``(18,)``."""
        q = np.array(self.direction)
        q = q / np.linalg.norm(q)
        body, rod = np.array(self.velocities[:3]), np.array(self.velocities[3:])
        return np.concatenate([np.eye(3).ravel(), q, body, rod - (q @ rod) * q])

    def f(self, t: float, y: Array) -> Array:
        """Return both angular velocities, and their derivatives.

        Parameters
        ----------
        t
            Time; the equations don't depend on it.
        y
            Points, shape ``(..., 18)``.

        Returns
        -------
        ndarray
            Shape ``(..., 12)``.
        """
        turn, q, body, rod = _parts(y)
        (mass, m), inertia = self.masses, np.array(self.inertia)
        joint, centre = np.array(self.joint), np.array(self.centre)
        q_body, up = _to_body(turn, q), turn[..., 2, :]
        known = np.cross(body, np.cross(body, joint)) + self.gravity * up
        pull = m * (self.length * np.vecdot(rod, rod) - np.vecdot(q_body, known))
        arm = np.cross(joint, q_body)
        torque = np.cross(inertia * body, body) - mass * self.gravity * np.cross(centre, up)
        torque += pull[..., None] * arm
        # The rod resists what the body's own turning adds: (I + m arm arm^T) turning = torque.
        free, resisted = torque / inertia, arm / inertia
        share = m * np.vecdot(arm, free) / (1.0 + m * np.vecdot(arm, resisted))
        turning = free - share[..., None] * resisted
        lifted = (turn @ (known + np.cross(turning, joint))[..., None])[..., 0]
        return np.concatenate([body, rod, turning, -np.cross(q, lifted) / self.length], axis=-1)

    def places(self, y: ArrayLike) -> tuple[Array, Array]:
        """Return where the pendulum hangs and where its mass is (m), each ``(..., 3)``."""
        turn, q, _, _ = _parts(self.frame._points(y))
        joint = turn @ np.array(self.joint)
        return joint, joint + self.length * q

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return energy, angular momentum about the vertical, and the rate of spin of the rod.

        Energy (J), momentum (kg m²/s) and rate (rad/s) have shape ``(...)``; the rate is zero.
        """
        points = self.frame._points(y)
        turn, q, body, rod = _parts(points)
        (mass, m), inertia = self.masses, np.array(self.inertia)
        _, place = self.places(points)
        speed = (turn @ np.cross(body, np.array(self.joint))[..., None])[..., 0]
        speed += self.length * np.cross(rod, q)
        kinetic = 0.5 * (np.vecdot(inertia * body, body) + m * np.vecdot(speed, speed))
        height = (turn @ np.array(self.centre))[..., 2]
        momentum = (turn @ (inertia * body)[..., None])[..., 0] + m * np.cross(place, speed)
        return {
            "energy": np.asarray(kinetic + self.gravity * (mass * height + m * place[..., 2])),
            "vertical momentum": momentum[..., 2],
            "spin": np.asarray(np.vecdot(q, rod)),
        }

    def reference(self, times: Sequence[float]) -> Array:
        """Return the solution at given times, accurate to about 1e-11, shape ``(n, 18)``.

        It is SciPy's DOP853 in the space around at its smallest tolerance, and knows nothing of
        frames.

        Raises
        ------
        ValueError
            If the times aren't finite and increasing from zero or later.
        """

        def ambient(t: float, y: Array) -> Array:
            turn, q, body, rod = _parts(y)
            rows = np.cross(turn, body)
            return np.concatenate([rows.ravel(), np.cross(rod, q), self.f(t, y)[6:]])

        return ambient_solution(ambient, self.y0, times)


def _parts(y: Array) -> tuple[Array, Array, Array, Array]:
    turn = y[..., :9].reshape(*y.shape[:-1], 3, 3)
    return turn, y[..., 9:12], y[..., 12:15], y[..., 15:18]


def _to_body(turn: Array, x: Array) -> Array:
    return np.asarray((turn.mT @ x[..., None])[..., 0])
