"""The free rigid body, with its exact solution in Jacobi's elliptic functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb
from numpy.typing import ArrayLike

from cg.frames import SO3, Product, Sphere
from cg.frames.arrays import Array
from cg.problems.checks import moments, times_array, vector
from cg.problems.elliptic import argument_of, jacobi_functions
from cg.problems.quadratic import QuadraticProblem, balls, identity
from cg.problems.taylor import ball

_FRAME = Product(SO3(), Sphere(2))

# Smallest complementary modulus whose square is a normal number
_SMALLEST = 1e-150


@dataclass(frozen=True)
class FreeRigidBody(QuadraticProblem):
    r"""A rigid body without external torques, in body coordinates.

    .. math:: B' = B\,\hat\omega, \qquad m' = m \times \omega, \qquad \omega = I^{-1} m,

    with the rotation :math:`B` from body to space axes and the angular momentum :math:`m` in
    body axes.  The length of :math:`m` is constant, so the unknown is the direction
    :math:`u = m/|m|` on the sphere: :math:`u' = -\omega \times u`.

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
        If the moments of inertia violate the triangle inequalities, or the momentum isn't three
        finite numbers or vanishes.

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

    def exact_momentum(self, t: ArrayLike) -> Array:
        r"""Return the angular momentum in body axes at given times, shape ``(..., 3)``.

        With :math:`a = 1/I`, the axis :math:`k` that the momentum encircles, the axis :math:`j` of
        the intermediate moment, and the remaining axis :math:`i`,

        .. math::

            m_i = \alpha\,\mathrm{cn}, \quad m_j = \beta\,\mathrm{sn}, \quad
            m_k = \gamma\,\mathrm{dn}(\lambda t + \delta \mid \kappa), \qquad
            \lambda^2 = (a_k - a_j)(2E - a_i |m|^2) .

        The error is the rounding of :math:`\lambda t`, also on and near the separatrix.

        Raises
        ------
        ValueError
            If a time isn't a finite number, or the complementary modulus is positive but less than
            1e-150, near the separatrix.
        """
        times = times_array(t)
        start = np.array(self.momentum)
        motion = _elliptic_parameters(self.inertia, self.momentum)
        if motion is None:
            return np.broadcast_to(start, (*times.shape, 3)).copy()
        (i, j, k), amplitudes, rate, complement = motion
        quotients = start / amplitudes
        shift = argument_of(quotients[j], quotients[i], complement)
        m = np.empty((*times.shape, 3))
        m[..., j], m[..., i], m[..., k] = jacobi_functions(rate * times + shift, complement)
        return m * amplitudes

    def _initial(self) -> list[arb]:
        return [*identity(), *(balls(self.momentum) / self._exact_size())]

    def _derivatives(self, y: Any) -> Any:
        # The rows of B and u change alike: x' = x cross omega.
        omega = self._exact_size() / balls(self.inertia) * y[9:]
        return np.cross(y.reshape(4, 3), omega).ravel()

    def _exact_size(self) -> arb:
        return sum((ball(x) ** 2 for x in self.momentum), arb(0)).sqrt()


def _elliptic_parameters(
    inertia: tuple[float, ...], momentum: tuple[float, ...]
) -> tuple[tuple[int, int, int], Array, float, float] | None:
    """Return the axes i, j, k, the amplitudes of m, the rate and the complementary modulus.

    It is None if the momentum is along a principal axis and constant.  Near the separatrix, where
    :math:`2E = a_j |m|^2`, the complementary modulus is a small difference, which fractions give
    without cancellation.

    Raises
    ------
    ValueError
        If the complementary modulus isn't zero, but too small for a double.
    """
    scale = 2.0 ** math.frexp(max(map(abs, momentum)))[1]
    a = [1 / Fraction(moment) for moment in inertia]
    squares = [(Fraction(x) / Fraction(scale)) ** 2 for x in momentum]
    i, j, k = sorted(range(3), key=a.__getitem__)
    # The sign of 2E - a_j |m|^2 determines the encircled axis.
    excess = _weighted(squares, [x - a[j] for x in a])
    if excess < 0:
        i, k = k, i
    # Distances of 2E from its bounds a_k |m|^2 and a_i |m|^2
    wide, high = (_weighted(squares, [abs(x - a[n]) for x in a]) for n in (k, i))
    outer, inner = abs(a[k] - a[i]), abs(a[k] - a[j])
    if sum(map(bool, momentum)) == 1 or not wide or not high or not inner:
        return None
    complement = _root(outer * abs(excess) / (inner * high))
    if excess and complement < _SMALLEST:
        raise ValueError(
            f"the motion with momentum {momentum!r} is too near the separatrix to be computed"
        )
    amplitudes = np.empty(3)
    amplitudes[i] = np.copysign(scale * _root(wide / outer), momentum[i])
    amplitudes[k] = np.copysign(scale * _root(high / outer), momentum[k])
    sign = (1.0 if (j - i) % 3 == 1 else -1.0) * (1.0 if a[i] > a[k] else -1.0)
    sign *= np.copysign(1.0, amplitudes[i]) * np.copysign(1.0, amplitudes[k])
    amplitudes[j] = sign * scale * _root(wide / inner)
    return (i, j, k), amplitudes, scale * _root(inner * high), complement


def _weighted(squares: Sequence[Fraction], weights: Sequence[Fraction]) -> Fraction:
    return sum((x * w for x, w in zip(squares, weights, strict=True)), Fraction(0))


def _root(x: Fraction) -> float:
    """Return the square root of a fraction, which may be outside the range of doubles."""
    half = (x.numerator.bit_length() - x.denominator.bit_length()) // 2
    return math.ldexp(math.sqrt(x / Fraction(4) ** half), half)
