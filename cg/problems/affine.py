"""Equations with coefficients affine in the point, for tests of the order on any frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames import Frame
from cg.frames.base import check_frame
from cg.problems.quadratic import QuadraticProblem
from cg.support import flint
from cg.support.arrays import Array
from cg.support.balls import to_ball
from cg.support.checks import check_integer
from cg.support.copies import ReadOnly

_UNIT = 8


class AffineProblem(ReadOnly, QuadraticProblem):
    """An equation with coefficients ``constant + linear @ y.ravel() + t * slope``.

    Its initial point is ``y0``, shape ``frame.point_shape``.
    """

    frame: Frame
    y0: Array
    constant: Array
    linear: Array
    slope: Array

    def f(self, t: float, y: Array) -> Array:
        """Return the coefficients, shape ``(..., dim)``, of points of shape ``(..., *shape)``."""
        lead = y.shape[: y.ndim - len(self.frame.point_shape)]
        return np.asarray(self.constant + t * self.slope + y.reshape(*lead, -1) @ self.linear.T)

    def _fields(self, y: Array) -> Array:
        """Return all fields at an array ``y`` of shape ``(n,)``, shape ``(dim, n)``."""
        point = y.reshape(self.frame.point_shape)
        fields = self.frame.field(np.eye(self.frame.dim), point)
        return np.asarray(fields).reshape(self.frame.dim, -1)

    @cached_property
    def _origin(self) -> Array:
        return self._fields(np.zeros(self.y0.size))

    @cached_property
    def _matrices(self) -> Array:
        """Matrices of the linear parts of the fields, shape ``(dim, n, n)``."""
        units = np.eye(self.y0.size)
        return np.stack([self._fields(unit) - self._origin for unit in units], axis=-1)

    def _initial(self) -> list[flint.arb]:
        return [*map(to_ball, self.y0.ravel()), flint.arb(0)]

    def _derivatives(self, y: Any) -> Any:
        # Unknowns: the entries of the point, and time
        point, t = y[:-1], y[-1]
        fields = self._matrices.astype(object) @ point + self._origin
        coefficients = self.linear.astype(object) @ point + self.constant + t * self.slope
        return [*(coefficients @ fields), 1.0]


@dataclass(frozen=True, eq=False)
class AffineField(AffineProblem):
    r"""An equation with coefficients :math:`f(t, y) = c + L\,\mathrm{vec}(y) + t\,w`.

    On frames whose fields are affine in the entries of the point, the equation is quadratic, so
    that Taylor series give its solution to any precision. The entries of :math:`c, L, w` are
    random multiples of 1/8, so that every tree contributes to the error of a method and a wrong
    coefficient reduces the observed order.

    The unknowns of `reference` are the entries of the point and time.

    Parameters
    ----------
    frame
        A frame with real points and affine fields: matrix groups, homogeneous spaces with a linear
        action, Euclidean space, products.
    initial
        The initial point, shape ``frame.point_shape``; the reference takes its entries as exact.
    seed
        Seed of the random numbers.

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
        check_frame(self.frame)
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
            ("y0", point),
            ("constant", numbers[:, 0]),
            ("slope", numbers[:, 1]),
            ("linear", numbers[:, 2:]),
        ):
            object.__setattr__(self, name, value)

        y = 2.0 * self.frame.random_point(rng).reshape(n)
        affine = self._origin + self._matrices @ y
        if not np.allclose(affine, self._fields(y), rtol=0.0, atol=1e-12):
            raise ValueError(f"frame must have fields that are affine, got {self.frame!r}")
