"""The equation of a solution and its derivatives together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.euclidean import Euclidean
from cg.frames.facts import facts_of
from cg.frames.product import Product
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.form import RhsForm
from cg.integration.rhs.inputs import Reader, data_at
from cg.integration.rhs.python import Derivative, Rhs, RhsCheck, time_text
from cg.support.arrays import Array, Points, check_finite, read_only
from cg.support.caches import cached_by_value
from cg.support.shared_numbers import MAX_LENGTH_RATIO

_VANISHING = float(np.sqrt(np.finfo(np.float64).tiny))
DIFFERENCE_STEP = float(np.finfo(np.float64).eps) ** (1 / 3)
"""Step of central differences, relative to the sizes of coordinates and of parameters."""


@dataclass(frozen=True, eq=False)
class VariationalEquation:
    r"""The coefficients of a solution and of its derivatives: a right-hand side on a product.

    A point is :math:`(y, X)` with :math:`X = (\Phi, S, C)`, shape ``(dim, columns)`` in C order.
    With chosen directions, the columns of :math:`(D, P)` in initial coordinates and parameters, X
    has one column for each and starts as D.
    The derivative of :math:`y` with respect to anything has coordinates :math:`\xi` in the frame,
    :math:`\partial y = \sum_i \xi_i E_i(y)`, and from :math:`y' = \sum_i f_i E_i(y)` follows

    .. math:: \xi' = \frac{\partial f}{\partial y} \xi + [f, \xi] + \frac{\partial f}{\partial p} ,

    with the bracket of `Frame.bracket`, whose sign is that of the frame's convention. Noise with
    the spectral density Q has the covariance C, with :math:`C' = A C + C A^T + Q` where
    :math:`A \xi` are the first two terms; without noise there is no C.
    """

    form: RhsForm  # the form of results of ``f``
    f: Any  # a `CompiledRhs` if it is compiled
    jac: Derivative | None
    df_dp: Derivative | None
    parameter_count: int  # number of parameters, with values of inputs if they have derivatives
    vectorized: bool = False  # whether the functions take points of several members in one call
    input_count: int = 0  # number of the parameters that are values of inputs
    noise: Derivative | Array | None = None  # spectral density of noise
    directions: Array | None = None  # chosen ones in initial coordinates and parameters, columns
    # whether forces alone make the coefficients, as a splitting method takes them: the tangents of
    # drifts are in fortran/frames/gyroscopic.f90
    forces_alone: bool = False
    one_sided: bool = False  # whether compiled code takes forward differences, from f at the point
    frame: Frame = field(init=False)
    product: Product = field(init=False)  # the frame of points with derivatives
    structure: StructureConstants = field(init=False, repr=False)
    check: RhsCheck = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vars(self)["frame"] = frame = self.form.frame
        vars(self).update(
            product=_product(frame, self.column_count),
            structure=_NO_CONSTANTS if self.forces_alone else structure_constants_of(frame),
            check=RhsCheck(self.f, self.form, self.vectorized),
        )

    @property
    def direction_count(self) -> int:
        """Number of columns that are derivatives of the solution."""
        n, directions = self.frame.dim, self.directions
        return n + self.parameter_count if directions is None else directions.shape[1]

    @property
    def column_count(self) -> int:
        """Number of all columns, with those of the covariance of noise."""
        return self.direction_count + (0 if self.noise is None else self.frame.dim)

    @property
    def has_point_directions(self) -> bool:
        """Whether the chosen directions are those of all initial coordinates."""
        of_points = np.eye(self.frame.dim + self.parameter_count, self.frame.dim)
        return self.directions is not None and np.array_equal(self.directions, of_points)

    def along_directions(self, derivatives: Array) -> Array:
        """Return derivatives with respect to parameters along the directions.

        The shape is ``(..., directions)``, of derivatives with respect to all parameters
        ``(..., k)``.
        """
        if self.directions is not None:
            return derivatives @ self.directions[self.frame.dim :]
        none = np.zeros((*derivatives.shape[:-1], self.frame.dim))
        return np.concatenate([none, derivatives], axis=-1)

    def __reduce__(self) -> tuple[Any, ...]:
        return VariationalEquation, tuple(getattr(self, x.name) for x in fields(self) if x.init)

    def start(self, y: Points) -> Array:
        """Return initial points with their derivatives, shape ``(members, *product shape)``."""
        n, directions = self.frame.dim, self.directions
        doubles = np.ascontiguousarray(y).reshape(len(y), -1).view(np.float64)
        z = np.empty((len(y), *self.product.point_shape))
        z[:, : doubles.shape[1]] = doubles
        x = np.eye(n, self.column_count) if directions is None else directions[:n]
        z[:, doubles.shape[1] :] = x.ravel()
        return z

    def split(self, z: Array) -> tuple[Points, Array]:
        """Return points and their derivatives, shape ``(..., dim, columns)``."""
        y, x = self.product.split(z)
        return y, x.reshape(*x.shape[:-1], self.frame.dim, self.column_count)

    def __call__(self, t: Array, z: Array, *arguments: Any) -> Array:
        """Return the coefficients of several members: those of ``f``, then the derivatives of X.

        They are NaN, which ends steps, at points that aren't finite, and where f isn't. For
        functions of one point ``fortran/runs/variational.f90`` evaluates them.
        """
        finite = np.isfinite(z).all(axis=-1)
        if not finite.all():
            return self._where(finite, t, z, arguments)
        y, x = self.split(z)
        coefficients = self.coefficients(t, y, arguments)
        finite = np.isfinite(coefficients).all(axis=-1)
        if not finite.all():
            return self._where(finite, t, z, arguments)
        (i, j, k), constants = self.structure.index, self.structure.constants
        with np.errstate(over="ignore", invalid="ignore"):
            jac = self.differences if self.jac is None else self.jac
            matrix = np.array(jac(t, y, arguments))
            entries: Any = slice(None), k, j
            np.add.at(matrix, entries, constants * coefficients[:, i])
            slope, m = matrix @ x, self.direction_count
            if self.parameter_count:
                df_dp = self._differences_by_parameters if self.df_dp is None else self.df_dp
                slope[..., :m] += self.along_directions(df_dp(t, y, arguments))
            if (noise := self.noise) is not None:
                density = noise(t, y, arguments) if isinstance(noise, Derivative) else noise
                slope[..., m:] += x[..., m:] @ matrix.mT + density
        if not np.isfinite(slope[np.isfinite(matrix).all(axis=(-2, -1))]).all():
            raise OverflowError(
                f"derivatives of the solution exceed the range of floating point at {time_text(t)}"
            )
        return np.concatenate([coefficients, slope.reshape(len(z), -1)], axis=-1)

    def _where(self, finite: Any, t: Array, z: Array, arguments: tuple[Any, ...]) -> Array:
        """Return the coefficients of the members that are finite, and NaN for the others."""
        values = np.full((len(z), self.product.dim), np.nan)
        if finite.any():
            if self.parameter_count:
                arguments = (*arguments[:-1], arguments[-1][finite])
            if arguments and isinstance(arguments[0], Reader):
                arguments = (arguments[0][finite], *arguments[1:])
            values[finite] = self(t[finite], z[finite], *arguments)
        return values

    def coefficients(
        self, t: Any, y: Points, arguments: tuple[Any, ...], whole: bool = False
    ) -> Array:
        """Return the coefficients at a point, or at points of several members.

        Where forces alone make them, free motion is left out unless the ``whole`` is asked for.
        """
        if isinstance(self.f, CompiledRhs):
            row: Array = self._at_points(t, y[None], arguments, whole)[0]
            return row
        return self._complete(self.check(self.f(t, read_only(y), *arguments), t), y, whole)

    def _complete(self, values: Array, y: Points, whole: bool) -> Array:
        complete = self.form.complete(values, y)
        if self.forces_alone and not whole:
            frame: Any = self.frame
            complete[..., : frame.rhs_dim] = 0.0
            complete[..., frame.rhs_dim :] = frame.tangential(y, values)
        return complete

    def differences(self, t: Any, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return differences of ``f`` along the frame's fields, shape ``(..., n, n)``."""
        n, shape = self.frame.dim, self.frame.point_shape
        lead = y.shape[: y.ndim - len(shape)]
        sizes = DIFFERENCE_STEP * np.maximum(self.frame.coordinate_sizes(y), 1.0)
        v = sizes[..., None, :] * np.concatenate([np.eye(n), -np.eye(n)])
        start = np.broadcast_to(y.reshape(*lead, 1, *shape), (*lead, 2 * n, *shape))
        values = self._at_points(t, self.frame.flow(v, start), arguments)
        differences: Array = values[..., :n, :] - values[..., n:, :]
        return np.ascontiguousarray(differences.mT / (2.0 * sizes[..., None, :]))

    def differences_along(self, t: Any, z: Array, *arguments: Any) -> Array:
        """Return differences of ``f`` along the directions, shape ``(dim, directions)``.

        They are taken as compiled code takes them on its frames, see `add_differences` in
        ``fortran/runs/variational.f90``.
        """
        y, x = self.split(z)
        shifts, numbers = np.zeros((x.shape[1], 0)), np.zeros(0)
        if self.df_dp is None and self.directions is not None and self.parameter_count:
            shifts, numbers = self.directions[len(x) :].T, arguments[-1]
        sizes, scales = np.maximum(self.frame.coordinate_sizes(y), 1.0), np.abs(numbers)
        scales[scales <= _VANISHING] = 1.0

        def at(point: Points, shift: Array) -> Array:
            shifted = (*arguments[:-1], numbers + shift) if shift.size else arguments
            return self.coefficients(t, point, shifted)

        slopes = np.zeros_like(x)
        for j, (v, shift) in enumerate(zip(x.T, shifts, strict=True)):
            lengths = np.abs(v / sizes).max(), np.abs(shift / scales).max(initial=0.0)
            changes = [(lengths[0], v, 0.0 * shift), (lengths[1], 0.0 * v, shift)]
            if min(lengths) * MAX_LENGTH_RATIO > max(lengths):
                changes = [(max(lengths), v, shift)]
            for length, along, change in changes:
                if length > 0.0:
                    step = DIFFERENCE_STEP / length
                    ends = self.frame.flow([step * along, -step * along], np.stack([y, y]))
                    difference = at(ends[0], step * change) - at(ends[1], -step * change)
                    slopes[:, j] += difference / (2.0 * step)
        return slopes

    def _at_points(
        self, t: Any, points: Points, arguments: tuple[Any, ...], whole: bool = False
    ) -> Array:
        """Return coefficients at several points of each member, shape ``(..., points, n)``."""
        if isinstance(self.f, CompiledRhs):
            data = data_at(t, arguments, self.parameter_count > 0)
            address = self.f.user_address if data is None else data.ctypes.data
            values = self.f.values(self.form, address, t, points)
            return self._complete(values, points, whole)
        if not self.vectorized:
            return np.array([self.coefficients(t, point, arguments) for point in points])
        count = points.shape[1]
        flat = points.reshape(-1, *self.frame.point_shape)
        if self.parameter_count:
            arguments = (*arguments[:-1], np.repeat(arguments[-1], count, axis=0))
        values = self.coefficients(np.repeat(t, count), flat, arguments)
        return values.reshape(len(points), count, -1)

    def _differences_by_parameters(self, t: Array, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return differences of ``f`` by the parameters, shape ``(members, n, k)``."""
        *others, rows = arguments
        return parameter_differences(lambda x: self.coefficients(t, y, (*others, x)), rows)


def parameter_steps(row: Array, step: float, scales: Any = 0.0) -> list[tuple[Array, Array]]:
    """Return for each parameter a step of it, as a change of all of them, and its size.

    Parameters have the shape ``(..., k)``. ``step`` is relative to the parameter or its scale, or
    to one if the square of both vanishes.
    """
    sizes = np.maximum(np.abs(row), scales)
    sizes = step * np.where(sizes > _VANISHING, sizes, 1.0)
    return [(sizes * unit, sizes[..., i]) for i, unit in enumerate(np.eye(row.shape[-1]))]


def parameter_differences(
    function: Callable[[Array], Array], row: Array, scales: Any = 0.0
) -> Array:
    """Return central differences of ``function(row)`` by each parameter, on a last axis."""
    columns = []
    for change, size in parameter_steps(row, DIFFERENCE_STEP, scales):
        ahead, behind = function(row + change), function(row - change)
        columns.append((ahead - behind) / (2.0 * size[..., None]))
    return np.stack(columns, axis=-1)


def count_parameters(rhs: Rhs, df_dp: Any, by_inputs: bool) -> tuple[int, int]:
    """Return the number of parameters of derivatives, values of inputs included, and of these.

    ValueError is raised if parameters aren't finite, or there are none for ``df_dp``.
    """
    numbers, inputs = rhs.extra.parameters, rhs.extra.inputs
    width = inputs.width if by_inputs and inputs is not None else 0
    if df_dp is not None and numbers is None and not width:
        raise ValueError(f"parameters must be given with df_dp = {df_dp!r}, got None")
    if numbers is None:
        return width, width
    check_finite("parameters", numbers if len(numbers) > 1 else numbers[0])
    return numbers.shape[-1] + width, width


def _product(frame: Frame, columns: int) -> Product:
    """Return the frame of points with columns of derivatives, which is kept."""
    products = facts_of(frame).products
    if columns not in products:
        products[columns] = Product(frame, Euclidean(frame.dim * columns))
    product: Product = products[columns]
    return product


class StructureConstants:
    """The structure constants of the fields that aren't zero.

    ``index`` holds i, j, k, shape ``(3, constants)``, and ``constants`` the parts of [E_i, E_j]
    along E_k. ``addresses`` are those of both as compiled code reads them.
    """

    def __init__(self, index: NDArray[np.intp], constants: Array) -> None:
        self.index, self.constants = index, constants
        # numbers count from 1; arrays can't be empty
        rows = np.ascontiguousarray(np.append(index.T, [[0, 0, 0]], axis=0) + 1, dtype=np.intc)
        self._kept = rows, np.append(constants, 0.0)
        self.addresses = self._kept[0].ctypes.data, self._kept[1].ctypes.data


_NO_CONSTANTS = StructureConstants(np.zeros((3, 0), dtype=np.intp), np.zeros(0))


@cached_by_value
def structure_constants_of(frame: Frame) -> StructureConstants:
    """Return the structure constants of a frame, which are kept."""
    basis = np.eye(frame.dim)
    rows, values = [np.zeros((3, 0), dtype=np.intp)], [np.zeros(0)]
    for i, e in enumerate(basis):
        brackets = frame.bracket(e, basis)
        j, k = np.nonzero(np.abs(brackets) > 1e-14 * np.abs(brackets).max(initial=0.0))
        rows.append(np.stack([np.full_like(j, i), j, k]))
        values.append(brackets[j, k])
    return StructureConstants(np.concatenate(rows, axis=1), np.concatenate(values))
