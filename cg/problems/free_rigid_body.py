"""The free rigid body, with its exact solution in Jacobi's elliptic functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from flint import arb
from numpy.typing import ArrayLike

from cg.frames import SO3, Product, Sphere
from cg.frames.arrays import Array
from cg.problems.checks import ball, cross_terms, moments, times_array, vector
from cg.problems.taylor import QuadraticSystem, Reference, Time, reference_solution

_FRAME = Product(SO3(), Sphere(2))


@dataclass(frozen=True)
class FreeRigidBody:
    r"""A rigid body that no torque acts on, in body coordinates.

    .. math:: B' = B\,\hat\omega, \qquad m' = m \times \omega, \qquad \omega = I^{-1} m,

    with the rotation :math:`B` from body to space axes and the angular momentum :math:`m` in
    body axes.  The length of :math:`m` is constant, so that its direction :math:`u = m/|m|` on
    the sphere is what moves: :math:`u' = -\omega \times u`.

    A point is the flat vector of the nine entries of :math:`B`, row by row, and of :math:`u`.

    Parameters
    ----------
    inertia
        Principal moments of inertia (kg m²).
    momentum
        Angular momentum in body axes at time zero (kg m²/s).

    Raises
    ------
    ValueError
        If no body has these moments, or the momentum isn't three numbers or vanishes.

    References
    ----------
    .. [1] L. D. Landau, E. M. Lifshitz, *Mechanics*, 3rd ed., Pergamon, 1976, section 37.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> problem = FreeRigidBody()
    >>> run = cg.integrate(
    ...     problem.f, (0, 5), problem.y0, frame=problem.frame, method="CG5a", h=0.05
    ... )
    >>> np.allclose(problem.body_momentum(run.y[-1]), problem.exact_momentum(5.0), atol=1e-8)
    True
    """

    inertia: tuple[float, ...] = (3.0, 2.0, 1.25)
    momentum: tuple[float, ...] = (0.6, 1.0, 1.5)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia", moments(self.inertia))
        object.__setattr__(self, "momentum", vector(self.momentum, "momentum", 3))
        if not any(self.momentum):
            raise ValueError(f"momentum must not vanish, got {self.momentum!r}")

    @property
    def frame(self) -> Product:
        """``Product(SO3(), Sphere(2))``."""
        return _FRAME

    @property
    def size(self) -> float:
        """The length of the angular momentum (kg m²/s)."""
        return float(np.linalg.norm(self.momentum))

    @property
    def y0(self) -> Array:
        """The initial point, with the body axes along those of space, shape ``(12,)``."""
        return self.frame.join(np.eye(3), np.array(self.momentum) / self.size)

    def f(self, t: float, y: Array) -> Array:
        """Return the coefficients, the angular velocity (rad/s) twice: shape ``(..., 6)``."""
        velocity = self.size * y[..., 9:] / np.array(self.inertia)
        return np.concatenate([velocity, -velocity], axis=-1)

    def body_momentum(self, y: ArrayLike) -> Array:
        """Return the angular momentum in body axes, shape ``(..., 3)``."""
        return np.asarray(self.size * self.frame.split(y)[1])

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return energy, shape ``(...)``, and momentum in space axes, shape ``(..., 3)``."""
        rotation = self.frame.split(y)[0]
        m = self.body_momentum(y)
        return {
            "energy": np.asarray((0.5 * m * m / np.array(self.inertia)).sum(axis=-1)),
            "spatial momentum": np.asarray((rotation @ m[..., None])[..., 0]),
        }

    def exact_momentum(self, t: ArrayLike) -> Array:
        r"""Return the angular momentum in body axes at given times, shape ``(..., 3)``.

        With :math:`a = 1/I`, about the axis :math:`k` that the motion encircles, the axis
        :math:`j` of the middle moment, and the third one :math:`i`,

        .. math::

            m_i = \alpha\,\mathrm{cn}, \quad m_j = \beta\,\mathrm{sn}, \quad
            m_k = \gamma\,\mathrm{dn}(\lambda t + \delta \mid \kappa), \qquad
            \lambda^2 = (a_k - a_j)(2E - a_i |m|^2) .
        """
        a, start = 1.0 / np.array(self.inertia), np.array(self.momentum)
        squares = start * start
        i, j, k = np.argsort(a, kind="stable").tolist()
        if (a - a[j]) @ squares < 0.0:
            i, k = k, i
        # Twice the energy lies between a_i |m|^2 and a_k |m|^2; as sums of terms of one sign these
        # distances keep their digits near the steady rotations.
        wide = abs(a[k] - a) @ squares
        high = abs(a - a[i]) @ squares
        times = times_array(t)
        if np.count_nonzero(start) == 1 or wide == 0.0 or high == 0.0 or a[k] == a[j]:
            # The momentum lies in a principal axis.
            return np.broadcast_to(start, (*times.shape, 3)).copy()
        outer, inner = abs(a[k] - a[i]), abs(a[k] - a[j])
        rate = np.sqrt(inner * high)
        parameter = min(abs(a[j] - a[i]) * wide / (inner * high), 1.0)
        even = (j - i) % 3 == 1
        third = np.copysign(np.sqrt(high / outer), start[k])
        first = np.sqrt(wide / outer)
        sign = (1.0 if even else -1.0) * np.sign(a[i] - a[k]) * np.sign(third)
        second = sign * np.sqrt(wide / inner)
        angle = np.arctan2(start[j] / second, start[i] / first)
        phase = rate * times + scipy.special.ellipkinc(angle, parameter)
        sn, cn, dn, _ = scipy.special.ellipj(phase, parameter)
        m = np.empty((*times.shape, 3))
        m[..., i], m[..., j], m[..., k] = first * cn, second * sn, third * dn
        return m

    def reference(self, times: Sequence[Time], *, bits: int = 256) -> Reference:
        """Return the solution, attitude included, at given times in extended precision.

        Raises
        ------
        ValueError
            If a time isn't a finite number.
        """
        return reference_solution(self._system, times, bits=bits)

    def _system(self) -> QuadraticSystem:
        size = sum((ball(x) ** 2 for x in self.momentum), arb(0)).sqrt()
        scale = [size / ball(moment) for moment in self.inertia]
        u = (9, 10, 11)
        rows = ((0, 1, 2), (3, 4, 5), (6, 7, 8), u)
        # Rows of B and u itself turn alike: x' = x cross omega.
        equations = [terms for row in rows for terms in cross_terms(row, u, scale)]
        start = [arb(int(i == j)) for i in range(3) for j in range(3)]
        start += [ball(x) / size for x in self.momentum]
        return QuadraticSystem(tuple(equations), tuple(start))
