"""The attitude of a spacecraft on a circular orbit: a quaternion beside an angular velocity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb
from numpy.typing import ArrayLike

from cg.frames import Euclidean, Product, UnitQuaternion
from cg.frames.arrays import Array
from cg.problems.checks import ball, cross_terms, moments, number, vector
from cg.problems.taylor import QuadraticSystem, Reference, Term, Time, reference_solution

_FRAME = Product(UnitQuaternion(), Euclidean(3))


@dataclass(frozen=True)
class Spacecraft:
    r"""A rigid spacecraft under the torque of gravity's gradient, and under control.

    The unit quaternion :math:`q` (scalar last) turns body axes to those of the orbit: the first
    points away from the planet, the third along the normal of the orbit, which is traversed at
    the rate :math:`n`.  With their directions in body axes, :math:`r` and :math:`h`,

    .. math::

        q' = \tfrac12\, q \otimes w, \quad w = \omega - n h, \qquad
        I \omega' = I\omega \times \omega + 3 n^2\, r \times I r - k_p \vec q - k_d w ,

    where :math:`\vec q` is the vector part of :math:`q`: the control aligns the two triads.

    A point is the flat vector of :math:`q` and of the angular velocity :math:`\omega` in body
    axes.

    Parameters
    ----------
    inertia
        Principal moments of inertia (kg m²).
    orbit_rate
        :math:`n` (rad/s).
    stiffness, damping
        :math:`k_p` (N m) and :math:`k_d` (N m s) of the control, zero for none.
    attitude
        The quaternion at time zero, of any length but zero.
    velocity
        Angular velocity at time zero (rad/s).

    Raises
    ------
    ValueError
        If a parameter isn't as many finite numbers, no body has these moments, or the quaternion
        vanishes.

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
        r"""Return the energy in the axes of the orbit, shape ``(...)``; damping alone changes it.

        It is :math:`\frac12 \omega^T I \omega - n h^T I \omega + \frac32 n^2 r^T I r +
        2 k_p (1 - q_4)`, Jacobi's integral with the potential of the control.
        """
        q, omega = self.frame.split(y)
        inertia, n = np.array(self.inertia), self.orbit_rate
        r, h = _orbit_axes(q)
        terms = 0.5 * omega * omega - n * h * omega + 1.5 * n * n * r * r
        control = 2.0 * self.stiffness * (1.0 - q[..., 3])
        return {"energy": np.asarray((inertia * terms).sum(axis=-1) + control)}

    def reference(self, times: Sequence[Time], *, bits: int = 256) -> Reference:
        """Return the solution at given times in extended precision.

        The unknowns are the entries of the point, then those of ``r`` and ``h``.

        Raises
        ------
        ValueError
            If a time isn't a finite number.
        """
        return reference_solution(self._system, times, bits=bits)

    def _system(self) -> QuadraticSystem:
        n, half = ball(self.orbit_rate), arb(1) / 2
        inertia = [ball(x) for x in self.inertia]
        one = [arb(1)] * 3
        omega, r, h = (4, 5, 6), (7, 8, 9), (10, 11, 12)
        equations: list[tuple[Term, ...]] = []
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            pairs = ((half, 3, i), (half, j, k), (-half, k, j))
            equations.append(_relative(pairs, omega, h, n))
        equations.append(_relative([(-half, i, i) for i in range(3)], omega, h, n))

        spin = cross_terms(omega, omega, inertia, -1)
        gravity = cross_terms(r, r, [3 * n * n * x for x in inertia])
        for i in range(3):
            control = (
                (-ball(self.stiffness), (i,)),
                (-ball(self.damping), (omega[i],)),
                (ball(self.damping) * n, (h[i],)),
            )
            terms = (*spin[i], *gravity[i], *control)
            equations.append(tuple((c / inertia[i], indices) for c, indices in terms))
        # Directions that the orbit's axes fix turn as x' = x cross (omega - n h).
        equations += [
            (*first, *second)
            for first, second in zip(
                cross_terms(r, omega, one), cross_terms(r, h, [-n] * 3), strict=True
            )
        ]
        equations += cross_terms(h, omega, one)

        q = [ball(x) for x in self.attitude]
        length = sum((x * x for x in q), arb(0)).sqrt()
        q = [x / length for x in q]
        axes = [x for axis in _orbit_axes_of(*q) for x in axis]
        start = (*q, *(ball(x) for x in self.velocity), *axes)
        return QuadraticSystem(tuple(equations), start)


def _relative(
    pairs: Sequence[tuple[arb, int, int]], omega: Sequence[int], h: Sequence[int], n: arb
) -> tuple[Term, ...]:
    """Return the terms of a sum of ``c * q[i] * (omega - n h)[j]``."""
    terms: list[Term] = []
    for c, i, j in pairs:
        terms += [(c, (i, omega[j])), (-c * n, (i, h[j]))]
    return tuple(terms)


def _orbit_axes(q: Array) -> tuple[Array, Array]:
    r, h = _orbit_axes_of(q[..., 0], q[..., 1], q[..., 2], q[..., 3])
    return np.stack(r, axis=-1), np.stack(h, axis=-1)


def _orbit_axes_of(x: Any, y: Any, z: Any, w: Any) -> tuple[list[Any], list[Any]]:
    """Return first and third row of the rotation matrix of a unit quaternion."""
    first = [w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)]
    third = [2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z]
    return first, third
