"""The double spherical pendulum, on two spheres and their angular velocities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cg.frames import Euclidean, Product, Sphere, hat
from cg.frames.arrays import Array
from cg.problems.ambient import ambient_solution
from cg.problems.checks import number, vector

_FRAME = Product(Sphere(2), Sphere(2), Euclidean(6))
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class DoubleSphericalPendulum:
    r"""Two masses on massless rods, the second hung from the first, free to swing in space.

    With the directions :math:`q_i` of the rods on the sphere, their angular velocities
    :math:`\omega_i \perp q_i`, :math:`M_{11} = (m_1 + m_2) l_1^2`, :math:`M_{12} = m_2 l_1 l_2`,
    :math:`M_{22} = m_2 l_2^2`, :math:`G_1 = (m_1 + m_2) g l_1` and :math:`G_2 = m_2 g l_2`,

    .. math::

        q_i' = \omega_i \times q_i, \qquad
        M_{ii} \omega_i' - M_{ij} \hat q_i \hat q_j\, \omega_j'
        = M_{ij} |\omega_j|^2\, q_i \times q_j - G_i\, q_i \times e_3, \qquad j \ne i .

    A point is the flat vector of :math:`q_1, q_2, \omega_1, \omega_2`.

    Parameters
    ----------
    masses
        :math:`m_1, m_2` (kg).
    lengths
        :math:`l_1, l_2` (m).
    gravity
        :math:`g` (m/s²), along :math:`-e_3`.
    directions
        The rods at time zero, six numbers, each three of any length but zero.
    velocities
        Their angular velocities at time zero (rad/s), six numbers; what is along a rod is left
        out.

    Raises
    ------
    ValueError
        If a parameter isn't as many finite numbers, a mass or a length isn't positive, or a
        direction vanishes.

    References
    ----------
    .. [1] T. Lee, M. Leok, N. H. McClamroch, "Lagrangian mechanics and variational integrators on
       two-spheres", Int. J. Numer. Meth. Eng. 79 (2009), 1147-1174.

    Examples
    --------
    >>> import cg
    >>> problem = DoubleSphericalPendulum()
    >>> run = cg.solve_ivp(problem.f, (0, 1), problem.y0, frame=problem.frame, rtol=1e-9, atol=1e-9)
    >>> [place.shape for place in problem.places(run.y[-1])]
    [(3,), (3,)]
    >>> energy = problem.invariants(run.y)["energy"]
    >>> bool(abs(energy - energy[0]).max() < 1e-7)
    True
    """

    masses: tuple[float, ...] = (1.0, 0.5)
    lengths: tuple[float, ...] = (1.0, 0.75)
    gravity: float = 9.81
    directions: tuple[float, ...] = (0.6, 0.0, -0.8, 0.0, 0.8, -0.6)
    velocities: tuple[float, ...] = (0.0, 0.5, 1.0, -0.5, 0.0, 0.5)

    def __post_init__(self) -> None:
        for name, n in (("masses", 2), ("lengths", 2), ("directions", 6), ("velocities", 6)):
            object.__setattr__(self, name, vector(getattr(self, name), name, n))
        object.__setattr__(self, "gravity", number(self.gravity, "gravity"))
        for name in ("masses", "lengths"):
            if min(getattr(self, name)) <= 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)!r}")
        if not (any(self.directions[:3]) and any(self.directions[3:])):
            raise ValueError(f"directions must not vanish, got {self.directions!r}")

    @property
    def frame(self) -> Product:
        """``Product(Sphere(2), Sphere(2), Euclidean(6))``."""
        return _FRAME

    @property
    def y0(self) -> Array:
        """The initial point, shape ``(12,)``."""
        q = np.reshape(self.directions, (2, 3))
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        omega = np.reshape(self.velocities, (2, 3))
        omega = omega - np.vecdot(q, omega)[:, None] * q
        return np.concatenate([q.ravel(), omega.ravel()])

    def f(self, t: float, y: Array) -> Array:
        """Return the angular velocities and their derivatives, shape ``(..., 12)``."""
        q1, q2, w1, w2 = _parts(y)
        (m11, m12, m22), (g1, g2) = self._inertia(), self._weights()
        coupling = m12 * hat(q1) @ hat(q2)
        matrix = np.zeros((*q1.shape[:-1], 6, 6))
        matrix[..., :3, :3] = m11 * np.eye(3)
        matrix[..., 3:, 3:] = m22 * np.eye(3)
        matrix[..., :3, 3:] = -coupling
        matrix[..., 3:, :3] = -coupling.swapaxes(-2, -1)
        across = np.cross(q1, q2)
        first = m12 * np.vecdot(w2, w2)[..., None] * across - g1 * np.cross(q1, _UP)
        second = -m12 * np.vecdot(w1, w1)[..., None] * across - g2 * np.cross(q2, _UP)
        side = np.concatenate([first, second], axis=-1)
        return np.concatenate([w1, w2, np.linalg.solve(matrix, side[..., None])[..., 0]], axis=-1)

    def places(self, y: ArrayLike) -> tuple[Array, Array]:
        """Return the places of the masses (m), each of shape ``(..., 3)``."""
        q1, q2, _, _ = _parts(self.frame._points(y))
        first = self.lengths[0] * q1
        return first, first + self.lengths[1] * q2

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return energy, angular momentum about the vertical, and rates of spin.

        Energy (J) and momentum (kg m²/s) have shape ``(...)``.  The rates of spin, the
        components of the angular velocities along the rods (rad/s), have shape ``(..., 2)``;
        they are zero.
        """
        q1, q2, w1, w2 = _parts(self.frame._points(y))
        (m11, m12, m22), (g1, g2) = self._inertia(), self._weights()
        v1, v2 = np.cross(w1, q1), np.cross(w2, q2)
        kinetic = 0.5 * (
            m11 * np.vecdot(v1, v1) + 2.0 * m12 * np.vecdot(v1, v2) + m22 * np.vecdot(v2, v2)
        )
        momentum = np.cross(q1, m11 * v1 + m12 * v2) + np.cross(q2, m12 * v1 + m22 * v2)
        return {
            "energy": np.asarray(kinetic + g1 * q1[..., 2] + g2 * q2[..., 2]),
            "vertical momentum": momentum[..., 2],
            "spin": np.stack([np.vecdot(q1, w1), np.vecdot(q2, w2)], axis=-1),
        }

    def reference(self, times: Sequence[float]) -> Array:
        """Return the solution at given times, accurate to about 1e-11, shape ``(n, 12)``.

        It is SciPy's DOP853 in the space around at its smallest tolerance, and knows nothing of
        frames.

        Raises
        ------
        ValueError
            If the times aren't finite and increasing from zero or later.
        """

        def ambient(t: float, y: Array) -> Array:
            q1, q2, w1, w2 = _parts(y)
            return np.concatenate([np.cross(w1, q1), np.cross(w2, q2), self.f(t, y)[6:]])

        return ambient_solution(ambient, self.y0, times)

    def _inertia(self) -> tuple[float, float, float]:
        (m1, m2), (l1, l2) = self.masses, self.lengths
        return (m1 + m2) * l1 * l1, m2 * l1 * l2, m2 * l2 * l2

    def _weights(self) -> tuple[float, float]:
        (m1, m2), (l1, l2) = self.masses, self.lengths
        return (m1 + m2) * self.gravity * l1, m2 * self.gravity * l2


def _parts(y: Array) -> tuple[Array, Array, Array, Array]:
    return y[..., 0:3], y[..., 3:6], y[..., 6:9], y[..., 9:12]
