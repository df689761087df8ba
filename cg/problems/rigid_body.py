"""Rigid bodies: free, and the heavy top."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from cg.frames import SO3, Euclidean, Product, Sphere
from cg.problems.linear import QuadraticProblem, balls, identity, moments, vector
from cg.support import flint
from cg.support.arrays import Array
from cg.support.checks import check_choice
from cg.support.parsing import read_fraction
from cg.support.quads import exact_midpoint, to_ball, to_flint, working_precision


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
        momentum = vector(self.momentum, "momentum", 3)
        vars(self).update(inertia=moments(self.inertia), momentum=momentum)
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


# More than twice the precision of binary128, so that constants are correctly rounded to it
_BITS = 240


@dataclass(frozen=True)
class HeavyTop(QuadraticProblem):
    r"""The heavy top in body coordinates.

    .. math::

        B' = B\, \widehat{I^{-1} m}, \qquad
        m' = m \times I^{-1} m + MgL\, (B^T e_3) \times e_3 ,

    with the rotation :math:`B` from body to space axes and the angular momentum :math:`m` in body
    axes, :math:`I = \mathrm{diag}(7, 7, 2)/8`, :math:`M = 1`, :math:`g = 9.81` and
    :math:`L = \sqrt 3/2`. The top starts from a rotation by :math:`-\varphi` about the first
    axis, with the vector :math:`\omega_0 = (0, 0, 1)`.

    A point is the flat vector of the nine entries of :math:`B`, row by row, and of :math:`m`.

    Parameters
    ----------
    reading
        Meaning of the initial vector: ``"momentum"`` for :math:`m(0) = \omega_0`, as in section 4
        of [1]_; ``"velocity"`` for :math:`m(0) = I \omega_0`.
    phi_over_pi
        The initial angle in units of :math:`\pi`, a rational number.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.

    Examples
    --------
    The problem of [1]_, with a method of order five:

    >>> import crouch_grossman as cg
    >>> problem = HeavyTop()
    >>> run = cg.integrate(
    ...     problem.f, (0, 1), problem.y0, frame=problem.frame, method="CG5a", h=0.01
    ... )
    >>> energy = problem.invariants(run.y)["energy"]
    >>> bool(abs(energy - energy[0]).max() < 1e-6)
    True
    """

    reading: Literal["momentum", "velocity"] = "momentum"
    phi_over_pi: Fraction = Fraction(1, 16)
    _floats: tuple[float, ...] = field(init=False, repr=False, compare=False)

    inertia = (Fraction(7, 8), Fraction(7, 8), Fraction(1, 4))
    mass = Fraction(1)
    gravity = Fraction(981, 100)
    frame = Product(SO3(), Euclidean(3))

    def __post_init__(self) -> None:
        check_choice("reading", self.reading, ("momentum", "velocity"))
        try:
            angle = read_fraction(self.phi_over_pi)
        except (TypeError, ValueError, OverflowError, ZeroDivisionError) as error:
            raise ValueError(f"phi_over_pi must be rational, got {self.phi_over_pi!r}") from error
        # Converted once, since f is called at each stage
        constants = (*(1 / moment for moment in self.inertia), self.mgl)
        vars(self).update(phi_over_pi=angle, _floats=tuple(map(float, constants)))

    @property
    def mgl(self) -> Fraction:
        """Mass times gravity times length, with more than 200 bits."""
        with working_precision(_BITS):
            return exact_midpoint(self._mgl())

    @property
    def y0_exact(self) -> tuple[Fraction, ...]:
        """The initial point, 12 numbers with more than 200 bits."""
        with working_precision(_BITS):
            return tuple(exact_midpoint(x) for x in self._initial())

    @property
    def y0(self) -> Array:
        """The initial point, shape ``(12,)``."""
        return np.array([float(x) for x in self.y0_exact])

    def f(self, t: float, y: Array) -> list[float]:
        """Return the angular velocity and the derivative of ``m`` at a point, shape ``(12,)``."""
        inverse1, inverse2, inverse3, mgl = self._floats
        up1, up2, _, m1, m2, m3 = y[6:].tolist()
        w1, w2, w3 = omega = inverse1 * m1, inverse2 * m2, inverse3 * m3
        return [
            *omega,
            m2 * w3 - m3 * w2 + mgl * up2,
            m3 * w1 - m1 * w3 - mgl * up1,
            m1 * w2 - m2 * w1,
        ]

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        r"""Return the three conserved quantities, each of shape ``(...)``.

        They are the energy :math:`\frac12 m^T I^{-1} m + MgL\,(B^T e_3)_3`, the vertical component
        of the momentum in space axes, and its component along the axis of symmetry.
        """
        rotation, m = self.frame.split(y)
        inverse, mgl = np.array(self._floats[:3]), self._floats[3]
        return {
            "energy": np.asarray(0.5 * (m * m * inverse).sum(axis=-1) + mgl * rotation[..., 2, 2]),
            "vertical momentum": np.asarray((rotation[..., 2, :] * m).sum(axis=-1)),
            "axial momentum": m[..., 2],
        }

    def _mgl(self) -> flint.arb:
        return to_ball(self.mass * self.gravity) * flint.arb(3).sqrt() / 2

    def _initial(self) -> tuple[flint.arb, ...]:
        angle = to_flint(self.phi_over_pi)
        sine, cosine = flint.arb.sin_cos_pi_fmpq(angle)
        zero, one = flint.arb(0), flint.arb(1)
        spin = one if self.reading == "momentum" else to_ball(self.inertia[2])
        return (one, zero, zero, zero, cosine, sine, zero, -sine, cosine, zero, zero, spin)

    def _derivatives(self, y: Any) -> Any:
        # The rows of B and m turn alike: x' = x cross (I^-1 m).
        velocity = np.array([to_ball(1 / moment) for moment in self.inertia]) * y[9:]
        derivatives = np.cross(y.reshape(4, 3), velocity).ravel()
        derivatives[9] += self._mgl() * y[7]
        derivatives[10] -= self._mgl() * y[6]
        return derivatives
