"""Fields whose coefficients are affine in the point: tests of order on any frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from math import prod

import numpy as np
from flint import arb
from numpy.typing import ArrayLike

from cg.frames import Frame
from cg.frames.arrays import Array
from cg.problems.checks import ball
from cg.problems.taylor import QuadraticSystem, Reference, Term, Time, reference_solution
from cg.support.checks import check_integer

_UNIT = 8


@dataclass(frozen=True, eq=False)
class AffineField:
    r"""A field with coefficients :math:`f(t, y) = c + L\,\mathrm{vec}(y) + t\,w`.

    On frames whose fields are affine in the entries of the point, the equation is quadratic, so
    that its solution is known to any precision without a Crouch-Grossman method.  The numbers in
    :math:`c, L, w` are random eighths: no symmetry hides the error of a tree, and misplaced
    coefficients of a method show in its order.

    Parameters
    ----------
    frame
        A frame with real points whose fields are affine: matrix groups, homogeneous spaces with a
        linear action, Euclidean space, products.
    initial
        The initial point, shape ``frame.point_shape``; its entries are taken as exact.
    seed
        Of the random numbers.

    Raises
    ------
    TypeError
        If ``frame`` isn't a `Frame`, or ``seed`` isn't an integer.
    ValueError
        If points are complex, ``initial`` isn't a point, or the fields aren't affine.

    Examples
    --------
    >>> import numpy as np
    >>> from cg.frames import SO3
    >>> problem = AffineField(SO3(), np.eye(3), seed=1)
    >>> problem.f(0.0, problem.y0)
    array([1.   , 0.5  , 0.875])
    """

    frame: Frame
    initial: ArrayLike
    seed: int = 0
    constant: Array = field(init=False, repr=False)
    linear: Array = field(init=False, repr=False)
    slope: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.frame, Frame):
            raise TypeError(f"frame must be a Frame such as SO3(), got {self.frame!r}")
        object.__setattr__(self, "seed", check_integer("seed", self.seed, 0))
        if self.frame.dtype.kind != "f":
            raise ValueError(
                f"frame must have real points, such as Product({self.frame!r}), got {self.frame!r}"
            )
        rng = np.random.default_rng(self.seed)
        m, n = self.frame.dim, prod(self.frame.point_shape)
        numbers = rng.integers(-4, 5, (m, n + 2)) / _UNIT
        point = self.frame.check_point(self.initial, name="initial")
        point.flags.writeable = False
        for name, value in (
            ("initial", point),
            ("constant", numbers[:, 0]),
            ("slope", numbers[:, 1]),
            ("linear", numbers[:, 2:]),
        ):
            object.__setattr__(self, name, value)

        y = 2.0 * self.frame.random_point(rng).reshape(n)
        affine = self._origin + self._matrices @ y
        if not np.allclose(affine, self._fields(y), rtol=0.0, atol=1e-12):
            raise ValueError(f"frame must have fields that are affine, got {self.frame!r}")

    @property
    def y0(self) -> Array:
        """The initial point, shape ``frame.point_shape``."""
        return np.asarray(self.initial)

    def f(self, t: float, y: Array) -> Array:
        """Return the coefficients, shape ``(..., dim)``, of points of shape ``(..., *shape)``."""
        lead = y.shape[: y.ndim - len(self.frame.point_shape)]
        return np.asarray(self.constant + t * self.slope + y.reshape(*lead, -1) @ self.linear.T)

    def reference(self, times: Sequence[Time], *, bits: int = 256) -> Reference:
        """Return the solution at given times in extended precision.

        The unknowns are the entries of the point in C order, and time itself.

        Raises
        ------
        ValueError
            If a time isn't a finite number.
        """
        return reference_solution(self._system, times, bits=bits)

    def _fields(self, y: Array) -> Array:
        """Return all fields at an array ``y`` of shape ``(n,)``, shape ``(dim, n)``."""
        point = y.reshape(self.frame.point_shape)
        return np.asarray(self.frame.field(np.eye(self.frame.dim), point)).reshape(
            self.frame.dim, -1
        )

    @cached_property
    def _origin(self) -> Array:
        return self._fields(np.zeros(self.y0.size))

    @cached_property
    def _matrices(self) -> Array:
        """Matrices of the linear parts of the fields, shape ``(dim, n, n)``."""
        units = np.eye(self.y0.size)
        return np.stack([self._fields(unit) - self._origin for unit in units], axis=-1)

    def _system(self) -> QuadraticSystem:
        clock = self.y0.size
        equations: list[tuple[Term, ...]] = []
        for row in range(clock):
            terms: dict[tuple[int, ...], arb] = {}
            for i in range(self.frame.dim):
                coefficient: dict[tuple[int, ...], float] = {
                    (): self.constant[i],
                    (clock,): self.slope[i],
                }
                coefficient |= {(j,): x for j, x in enumerate(self.linear[i])}
                entry: dict[tuple[int, ...], float] = {(): self._origin[i, row]}
                entry |= {(k,): x for k, x in enumerate(self._matrices[i, row])}
                for (p, a), (q, b) in product(coefficient.items(), entry.items()):
                    if a and b:
                        indices = tuple(sorted((*p, *q)))
                        terms[indices] = terms.get(indices, arb(0)) + ball(a) * ball(b)
            equations.append(tuple((value, indices) for indices, value in terms.items()))
        equations.append(((arb(1), ()),))
        start = (*(ball(x) for x in self.y0.ravel()), arb(0))
        return QuadraticSystem(tuple(equations), start)
