"""The free rigid body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames import SO3, Product, Sphere
from cg.problems.quadratic import QuadraticProblem, balls, identity, moments, vector
from cg.support import flint
from cg.support.arrays import Array
from cg.support.balls import to_ball


@dataclass(frozen=True)
class FreeRigidBody(QuadraticProblem):
    r"""A rigid body without external torques, in body coordinates.

    .. math:: B' = B\,\hat\omega, \qquad m' = m \times \omega, \qquad \omega = I^{-1} m,

    with the rotation :math:`B` from body to space axes and the angular momentum :math:`m` in
    body axes. The length of :math:`m` is constant, so the unknown is the direction
    :math:`u = m/|m|` on the sphere: :math:`u' = -\omega \times u`.

    A point is the flat vector of the nine entries of :math:`B`, row by row, and of :math:`u`.

    Parameters
    ----------
    inertia
        Principal moments of inertia (kg m²), each at most the sum of the others.
    momentum
        Angular momentum in body axes at time zero (kg m²/s), not zero.

    References
    ----------
    .. [1] L. D. Landau, E. M. Lifshitz, *Mechanics*, 3rd ed., Pergamon, 1976, section 37.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> problem = FreeRigidBody()
    >>> run = cg.integrate(
    ...     problem.f, (0, 5), problem.y0, frame=problem.frame, method="CG5a", h=0.05
    ... )
    >>> np.allclose(run.y[-1], problem.reference([5]).y[0], atol=1e-8)
    True
    """

    inertia: tuple[float, ...] = (3.0, 2.0, 1.25)
    momentum: tuple[float, ...] = (0.6, 1.0, 1.5)

    frame = Product(SO3(), Sphere(2))

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia", moments(self.inertia))
        object.__setattr__(self, "momentum", vector(self.momentum, "momentum", 3))
        if not any(self.momentum):
            raise ValueError(f"momentum must not vanish, got {self.momentum!r}")

    @property
    def size(self) -> float:
        """The length of the angular momentum (kg m²/s)."""
        return float(np.linalg.norm(self.momentum))

    @property
    def y0(self) -> Array:
        """The initial point, with the identity as the attitude, shape ``(12,)``."""
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

    def _initial(self) -> list[flint.arb]:
        return [*identity(), *(balls(self.momentum) / self._exact_size())]

    def _derivatives(self, y: Any) -> Any:
        # The rows of B and u change alike: x' = x cross omega.
        omega = self._exact_size() / balls(self.inertia) * y[9:]
        return np.cross(y.reshape(4, 3), omega).ravel()

    def _exact_size(self) -> flint.arb:
        return sum((to_ball(x) ** 2 for x in self.momentum), flint.arb(0)).sqrt()
