"""A ball that rolls on a turntable without slipping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb
from numpy.typing import ArrayLike

from cg.frames import SO3, Euclidean, Product
from cg.frames.arrays import Array
from cg.problems.checks import ball, number, times_array, vector
from cg.problems.taylor import QuadraticSystem, Reference, Term, Time, reference_solution

_FRAME = Product(SO3("space"), Euclidean(5))


@dataclass(frozen=True)
class RollingBall:
    r"""A homogeneous ball that rolls without slipping on a table turning at a constant rate.

    In space axes, with the attitude :math:`R`, the angular velocity :math:`\omega`, the place
    :math:`x` of the centre over the table, its velocity :math:`v`, the radius :math:`r` and the
    rate :math:`\Omega` of the table,

    .. math::

        R' = \hat\omega R, \qquad \omega' = \tfrac{5 \Omega}{7 r}\, v, \qquad
        x' = v = \Omega\, e_3 \times x + r\, \omega \times e_3 .

    The last equation is the constraint that the point of contact moves with the table.  The
    centre goes in circles, :math:`v' = \tfrac27 \Omega\, e_3 \times v`.

    A point is the flat vector of the nine entries of :math:`R`, row by row, of :math:`\omega`,
    and of the two coordinates of :math:`x`.

    Parameters
    ----------
    table_rate
        :math:`\Omega` (rad/s).
    radius
        :math:`r` (m).
    velocity
        Angular velocity at time zero, in space axes (rad/s).
    place
        Where the ball touches the table at time zero (m).

    Raises
    ------
    ValueError
        If a parameter isn't as many finite numbers, or the radius isn't positive.

    References
    ----------
    .. [1] P. E. Crouch, R. Grossman, "Numerical integration of ordinary differential equations
       on manifolds", J. Nonlinear Sci. 3 (1993), 1-33.
    .. [2] K. Weltner, "Stable circular orbits of freely moving balls on rotating discs",
       Am. J. Phys. 47 (1979), 984-986.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> problem = RollingBall()
    >>> run = cg.integrate(problem.f, (0, 2), problem.y0, frame=problem.frame, method="CF4", h=0.02)
    >>> np.allclose(run.y[-1, 12:], problem.exact_place(2.0), atol=1e-6)
    True
    """

    table_rate: float = 2.0
    radius: float = 0.5
    velocity: tuple[float, ...] = (0.5, -1.0, 1.5)
    place: tuple[float, ...] = (1.0, 0.25)

    def __post_init__(self) -> None:
        object.__setattr__(self, "table_rate", number(self.table_rate, "table_rate"))
        object.__setattr__(self, "radius", number(self.radius, "radius", positive=True))
        object.__setattr__(self, "velocity", vector(self.velocity, "velocity", 3))
        object.__setattr__(self, "place", vector(self.place, "place", 2))

    @property
    def frame(self) -> Product:
        """``Product(SO3("space"), Euclidean(5))``."""
        return _FRAME

    @property
    def y0(self) -> Array:
        """The initial point, with the identity for the attitude, shape ``(14,)``."""
        return self.frame.join(np.eye(3), (*self.velocity, *self.place))

    def f(self, t: float, y: Array) -> Array:
        """Return angular velocity, its derivative, and velocity, shape ``(..., 8)``."""
        omega = y[..., 9:12]
        v = self.centre_velocity(y)
        turn = np.zeros_like(omega)
        turn[..., :2] = 5.0 * self.table_rate / (7.0 * self.radius) * v
        return np.concatenate([omega, turn, v], axis=-1)

    def centre_velocity(self, y: ArrayLike) -> Array:
        """Return the velocity of the centre (m/s), shape ``(..., 2)``."""
        state = self.frame.split(y)[1]
        omega, place = state[..., :3], state[..., 3:]
        return np.stack(
            [
                -self.table_rate * place[..., 1] + self.radius * omega[..., 1],
                self.table_rate * place[..., 0] - self.radius * omega[..., 0],
            ],
            axis=-1,
        )

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        r"""Return the constants of the motion.

        The spin about the vertical and the centre's speed, each of shape ``(...)``; and the
        horizontal part of :math:`\omega - \frac{5 \Omega}{7 r} x`, shape ``(..., 2)``.
        """
        state = self.frame.split(y)[1]
        factor = 5.0 * self.table_rate / (7.0 * self.radius)
        return {
            "spin": state[..., 2],
            "speed": np.asarray(np.linalg.norm(self.centre_velocity(y), axis=-1)),
            "turn over place": np.asarray(state[..., :2] - factor * state[..., 3:]),
        }

    def exact_place(self, t: ArrayLike) -> Array:
        """Return the centre's place over the table at given times, shape ``(..., 2)``."""
        times = times_array(t)
        x, v = complex(*self.place), complex(*self.centre_velocity(self.y0))
        rate = 2.0 * self.table_rate / 7.0
        # The mean of exp(i rate s) over s up to t.
        mean = np.exp(0.5j * rate * times) * np.sinc(0.5 * rate * times / np.pi)
        z = x + v * times * mean
        return np.stack([z.real, z.imag], axis=-1)

    def reference(self, times: Sequence[Time], *, bits: int = 256) -> Reference:
        """Return the solution, attitude included, at given times in extended precision.

        Raises
        ------
        ValueError
            If a time isn't a finite number.
        """
        return reference_solution(self._system, times, bits=bits)

    def _system(self) -> QuadraticSystem:
        one, rate, radius = arb(1), ball(self.table_rate), ball(self.radius)
        factor = 5 * rate / (7 * radius)
        v: list[tuple[Term, ...]] = [
            ((-rate, (13,)), (radius, (10,))),
            ((rate, (12,)), (-radius, (9,))),
        ]
        equations: list[tuple[Term, ...]] = []
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            # Columns of R turn as omega cross r.
            equations += [((one, (9 + j, 3 * k + n)), (-one, (9 + k, 3 * j + n))) for n in range(3)]
        equations += [tuple((factor * c, i) for c, i in terms) for terms in v]
        equations += [(), *v]
        start = [arb(int(i == j)) for i in range(3) for j in range(3)]
        start += [ball(x) for x in (*self.velocity, *self.place)]
        return QuadraticSystem(tuple(equations), tuple(start))
