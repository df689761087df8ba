"""Right-hand sides of a solution and its derivatives together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.euclidean import Euclidean
from cg.frames.product import Product
from cg.integration.rhs.checks import Check, when
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.given_derivatives import Derivative, read_only
from cg.integration.rhs.inputs import Reader, data_at
from cg.support.arrays import Array, Points
from cg.support.caches import cached_by_value

_VANISHING = float(np.sqrt(np.finfo(np.float64).tiny))
_NO_CONSTANTS = np.zeros((3, 0), dtype=np.intp), np.zeros(0)
DIFFERENCE_STEP = float(np.finfo(np.float64).eps) ** (1 / 3)
"""Step of central differences, relative to the sizes of coordinates and of parameters."""


@dataclass(frozen=True, eq=False)
class VariationalField:
    r"""The coefficients of a solution and of its derivatives: a right-hand side on a product.

    A point is :math:`(y, X)` with :math:`X = (\Phi, S, C)`, shape ``(dim, columns)`` in C order.
    Along chosen directions, the columns of :math:`(D, P)`, X starts as D, and has no other parts.
    The derivative of :math:`y` with respect to anything has coordinates :math:`\xi` in the frame,
    :math:`\partial y = \sum_i \xi_i E_i(y)`, and from :math:`y' = \sum_i f_i E_i(y)` follows

    .. math:: \xi' = \frac{\partial f}{\partial y} \xi + [f, \xi] + \frac{\partial f}{\partial p} ,

    with the bracket of `Frame.bracket`, whose sign is that of the frame's convention. Noise with
    the spectral density Q has the covariance C, with :math:`C' = A C + C A^T + Q` where
    :math:`A \xi` are the first two terms; without noise there is no C.
    """

    frame: Frame
    f: Any  # a `CompiledRhs` if it is compiled
    jac: Derivative | None
    df_dp: Derivative | None
    count: int  # number of parameters, with inputs if there are derivatives with respect to them
    vectorized: bool = False  # whether the functions take points of several members in one call
    inputs: int = 0  # number of the parameters that are values of inputs
    noise: Derivative | Array | None = None  # spectral density of noise
    chosen: Array | None = None  # directions in initial coordinates and parameters, columns
    # whether forces alone make the coefficients, as a splitting method takes them: the tangents of
    # drifts are in fortran/frames/tangent_motion.f90
    kicks: bool = False

    @property
    def directions(self) -> int:
        """Number of columns that are derivatives of the solution."""
        return self.frame.dim + self.count if self.chosen is None else self.chosen.shape[1]

    @property
    def columns(self) -> int:
        """Number of all columns, with those of the covariance of noise."""
        return self.directions + (0 if self.noise is None else self.frame.dim)

    @property
    def by_point(self) -> bool:
        """Whether the chosen directions are those of all initial coordinates."""
        n, chosen = self.frame.dim, self.chosen
        return chosen is not None and np.array_equal(chosen, np.eye(n + self.count, n))

    def by_parameters(self, derivatives: Array) -> Array:
        """Return derivatives with respect to parameters along the directions.

        The shape is ``(..., directions)``, of derivatives with respect to all parameters
        ``(..., k)``.
        """
        if self.chosen is not None:
            return derivatives @ self.chosen[self.frame.dim :]
        none = np.zeros((*derivatives.shape[:-1], self.frame.dim))
        return np.concatenate([none, derivatives], axis=-1)

    def __post_init__(self) -> None:
        vars(self).update(
            product=Product(self.frame, Euclidean(self.frame.dim * self.columns)),
            structure=_NO_CONSTANTS if self.kicks else structure_constants(self.frame),
            check=Check(self.f, self.frame, self.vectorized),
        )

    product: Product = field(init=False)  # the frame of points with derivatives
    # the indices (i, j, k) of structure constants, and the constants
    structure: tuple[NDArray[np.intp], Array] = field(init=False, repr=False)
    check: Check = field(init=False, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        functions, numbers = (self.f, self.jac, self.df_dp), (self.count, self.vectorized)
        others = self.inputs, self.noise, self.chosen, self.kicks
        return VariationalField, (self.frame, *functions, *numbers, *others)

    def start(self, y: Points) -> Array:
        """Return initial points with their derivatives, shape ``(members, *product shape)``."""
        n = self.frame.dim
        x = np.eye(n, self.columns).ravel() if self.chosen is None else self.chosen[:n].ravel()
        return self.product.join(y, np.broadcast_to(x, (len(y), x.size)))

    def split(self, z: Array) -> tuple[Points, Array]:
        """Return points and their derivatives, shape ``(..., dim, columns)``."""
        y, x = self.product.split(z)
        n = self.frame.dim
        return y, x.reshape(*x.shape[:-1], n, self.columns)

    def __call__(self, t: Array, z: Array, *arguments: Any) -> Array:
        """Return the coefficients of several members: those of ``f``, then the derivatives of X.

        They are NaN, which ends steps, at points that aren't finite, and where f isn't. For
        functions of one point ``fortran/interface/variational.f90`` evaluates them.
        """
        finite = np.isfinite(z).all(axis=-1)
        if not finite.all():
            return self._at_some(finite, t, z, arguments)
        y, x = self.split(z)
        coefficients = self.coefficients(t, y, arguments)
        finite = np.isfinite(coefficients).all(axis=-1)
        if not finite.all():
            return self._at_some(finite, t, z, arguments)
        (i, j, k), constant = self.structure
        with np.errstate(over="ignore", invalid="ignore"):
            jac = self.differences if self.jac is None else self.jac
            matrix = np.array(jac(t, y, arguments))
            where: Any = slice(None), k, j
            np.add.at(matrix, where, constant * coefficients[:, i])
            slope = matrix @ x
            m = self.directions
            if self.count:
                slope[..., :m] += self.by_parameters(self._parameter_derivative(t, y, arguments))
            if self.noise is not None:
                noise = self.noise
                density = noise(t, y, arguments) if isinstance(noise, Derivative) else noise
                slope[..., m:] += x[..., m:] @ matrix.mT + density
        if not np.isfinite(slope[np.isfinite(matrix).all(axis=(-2, -1))]).all():
            raise OverflowError(
                f"derivatives of the solution exceed the range of floating point at {when(t)}"
            )
        return np.concatenate([coefficients, slope.reshape(len(z), -1)], axis=-1)

    def _at_some(self, some: Any, t: Array, z: Array, arguments: tuple[Any, ...]) -> Array:
        """Return the coefficients of some members, and NaN for the others."""
        values = np.full((len(z), self.product.dim), np.nan)
        if some.any():
            if self.count:
                arguments = (*arguments[:-1], arguments[-1][some])
            if arguments and isinstance(arguments[0], Reader):
                arguments = (arguments[0][some], *arguments[1:])
            values[some] = self(t[some], z[some], *arguments)
        return values

    def coefficients(
        self, t: Any, y: Points, arguments: tuple[Any, ...], whole: bool = False
    ) -> Array:
        """Return the coefficients at a point, or at points of several members.

        Those of kicks have no free motion, unless the ``whole`` ones are asked for.
        """
        if isinstance(self.f, CompiledRhs):
            row: Array = self._at_points(t, y[None], arguments, whole)[0]
            return row
        return self._complete(self.check(self.f(t, read_only(y), *arguments), t), y, whole)

    def _complete(self, values: Array, y: Points, whole: bool) -> Array:
        complete = self.frame.complete_rhs(values, y)
        if self.kicks and not whole:
            frame: Any = self.frame
            complete[..., : frame.rhs_dim] = 0.0
            complete[..., frame.rhs_dim :] = frame.tangential(y, values)
        return complete

    def differences(self, t: Any, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return differences of ``f`` along the frame's fields, shape ``(..., n, n)``."""
        n = self.frame.dim
        lead = y.shape[: y.ndim - len(self.frame.point_shape)]
        sizes = DIFFERENCE_STEP * np.maximum(self.frame.coordinate_sizes(y), 1.0)
        v = sizes[..., None, :] * np.concatenate([np.eye(n), -np.eye(n)])
        start = np.broadcast_to(
            y.reshape(*lead, 1, *self.frame.point_shape), (*lead, 2 * n, *self.frame.point_shape)
        )
        values = self._at_points(t, self.frame.flow(v, start), arguments)
        differences: Array = values[..., :n, :] - values[..., n:, :]
        return np.ascontiguousarray(differences.mT / (2.0 * sizes[..., None, :]))

    def _at_points(
        self, t: Any, points: Points, arguments: tuple[Any, ...], whole: bool = False
    ) -> Array:
        """Return coefficients at several points of each member, shape ``(..., points, n)``."""
        if isinstance(self.f, CompiledRhs):
            data = data_at(t, arguments, self.count > 0)
            address = self.f.user_data if data is None else data.ctypes.data
            values = self.f.values(self.frame, address, t, points)
            return self._complete(values, points, whole)
        if not self.vectorized:
            return np.array([self.coefficients(t, point, arguments) for point in points])
        each = points.shape[1]
        flat = points.reshape(-1, *self.frame.point_shape)
        if self.count:
            arguments = (*arguments[:-1], np.repeat(arguments[-1], each, axis=0))
        values = self.coefficients(np.repeat(t, each), flat, arguments)
        return values.reshape(len(points), each, -1)

    def _parameter_derivative(self, t: Array, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return derivatives of ``f`` with respect to parameters, shape ``(members, n, k)``."""
        if self.df_dp is not None:
            return self.df_dp(t, y, arguments)
        return parameter_differences(
            lambda row: self.coefficients(t, y, (*arguments[:-1], row)), arguments[-1]
        )


def parameter_steps(row: Array, step: float, scales: Any = 0.0) -> list[tuple[Any, Array]]:
    """Return for each parameter a function that shifts it by some steps, and the step size.

    Parameters have the shape ``(..., k)``. ``step`` is relative to the parameter or its scale, or
    to one if the square of both vanishes.
    """
    steps_of = []
    sizes = np.maximum(np.abs(row), scales)
    for i in range(row.shape[-1]):
        size = step * np.where(sizes[..., i] > _VANISHING, sizes[..., i], 1.0)

        def moved(steps: float, i: int = i, size: Array = size) -> Array:
            other = row.copy()
            other[..., i] += steps * size
            return other

        steps_of.append((moved, np.asarray(size)))
    return steps_of


def parameter_differences(
    function: Callable[[Array], Array], row: Array, scales: Any = 0.0
) -> Array:
    """Return central differences of ``function(row)`` by each parameter, on a last axis."""
    columns = []
    for moved, size in parameter_steps(row, DIFFERENCE_STEP, scales):
        ahead, behind = function(moved(1.0)), function(moved(-1.0))
        columns.append((ahead - behind) / (2.0 * size[..., None]))
    return np.stack(columns, axis=-1)


@cached_by_value
def structure_constants(frame: Frame) -> tuple[NDArray[np.intp], Array]:
    """Return the indices i, j, k, shape ``(3, constants)``, and those of [E_i, E_j] along E_k."""
    basis = np.eye(frame.dim)
    rows, values = [np.zeros((3, 0), dtype=np.intp)], [np.zeros(0)]
    for i, e in enumerate(basis):
        brackets = frame.bracket(e, basis)
        j, k = np.nonzero(np.abs(brackets) > 1e-14 * np.abs(brackets).max(initial=0.0))
        rows.append(np.stack([np.full_like(j, i), j, k]))
        values.append(brackets[j, k])
    return np.concatenate(rows, axis=1), np.concatenate(values)
