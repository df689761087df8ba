"""Right-hand sides of a solution and its derivatives together, in Python."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cg.frames.algebra import MAX_CONSTANTS
from cg.frames.arrays import Array, Points, is_array, real_array
from cg.frames.base import Frame
from cg.frames.euclidean import Euclidean
from cg.frames.product import Product
from cg.integration.rhs.compiled import CompiledRhs, compiled_rhs
from cg.integration.rhs.python import PythonRhs, when
from cg.integration.step.flows import Flows, flows_of

DIFFERENCE_STEP = float(np.finfo(np.float64).eps) ** (1 / 3)
"""Step of central differences, relative to the sizes of coordinates and of parameters."""

Function = Any
"""A function of Python, or a `CompiledRhs`."""


@dataclass(frozen=True, eq=False)
class VariationalField:
    r"""The coefficients of a solution and of its derivatives: a right-hand side on a product.

    A point is :math:`(y, X)` with :math:`X = (\Phi, S)`, shape ``(dim, dim + k)`` in C order.  The
    derivative of :math:`y` with respect to anything has coordinates :math:`\xi` in the frame,
    :math:`\partial y = \sum_i \xi_i E_i(y)`, and from :math:`y' = \sum_i f_i E_i(y)` follows

    .. math:: \xi' = \frac{\partial f}{\partial y} \xi + [f, \xi] + \frac{\partial f}{\partial p} ,

    with the bracket of `Frame.bracket`, whose sign is that of the frame's convention.

    Attributes
    ----------
    frame
        The frame of the solution.
    f, jac, df_dp
        The functions of the user, `CompiledRhs` if they are compiled; ``jac`` and ``df_dp`` may
        be None.
    count
        Number of parameters.
    vectorized
        Whether the functions take points of several members in one call.
    """

    frame: Frame
    f: Function
    jac: Function
    df_dp: Function
    count: int
    vectorized: bool = False
    product: Product = field(init=False)

    def __post_init__(self) -> None:
        for name in ("f", "jac", "df_dp"):
            function = getattr(self, name)
            object.__setattr__(self, name, compiled_rhs(function, name) or function)
        n = self.frame.dim
        product = Product(self.frame, Euclidean(n * (n + self.count)))
        object.__setattr__(self, "product", product)
        object.__setattr__(self, "_rhs", PythonRhs(self.f, self.frame, vectorized=self.vectorized))
        object.__setattr__(self, "_flows", flows_of(self.frame))
        object.__setattr__(self, "_constants", _constants(self.frame))

    _rhs: PythonRhs = field(init=False, repr=False, compare=False)
    _flows: Flows = field(init=False, repr=False, compare=False)
    _constants: Array | None = field(init=False, repr=False, compare=False)

    def __reduce__(self) -> tuple[Any, ...]:
        # addresses mean nothing to other processes
        functions = [
            function.function if isinstance(function, CompiledRhs) else function
            for function in (self.f, self.jac, self.df_dp)
        ]
        return VariationalField, (self.frame, *functions, self.count, self.vectorized)

    def functions(self) -> list[tuple[str, Function, tuple[int, ...]]]:
        """Return the functions with their names and the shapes of what they return."""
        n = self.frame.dim
        return [
            ("f", self.f, (self.frame.rhs_dim,)),
            ("jac", self.jac, (n, n)),
            ("df_dp", self.df_dp, (n, self.count)),
        ]

    def check_of(self, name: str) -> Callable[[Any, float, Points], Array]:
        """Return a function that checks the value of a Python function at one point."""
        if name == "f":
            return self._rhs.check
        shape = {name: shape for name, _, shape in self.functions()}[name]
        return lambda value, t, y: self._checked(name, value, t, shape)

    def start(self, y: Points) -> Array:
        """Return initial points with their derivatives, shape ``(members, *product shape)``."""
        n = self.frame.dim
        x = np.concatenate([np.eye(n), np.zeros((n, self.count))], axis=1).ravel()
        return self.product.join(y, np.broadcast_to(x, (len(y), x.size)))

    def split(self, z: Array) -> tuple[Points, Array]:
        """Return points and their derivatives, shape ``(..., dim, dim + k)``."""
        y, x = self.product.split(z)
        n = self.frame.dim
        return y, x.reshape(*x.shape[:-1], n, n + self.count)

    def __call__(self, t: Any, z: Array, *arguments: Any) -> Array:
        """Return the coefficients at ``z``: those of ``f``, then the derivatives of ``X``."""
        if not math.isfinite(z.sum()) and not np.isfinite(z).all():
            return self._where_finite(t, z, arguments)
        y, x = self.split(z)
        coefficients = self.coefficients(t, y, arguments)
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = self.jacobian(t, y, arguments)
            if self._constants is None or self._constants.size:
                matrix = matrix + self._adjoint(coefficients)
            slope = matrix @ x
            if self.count:
                slope[..., self.frame.dim :] += self.parameter_derivative(t, y, arguments)
        if not math.isfinite(slope.sum()) and not np.isfinite(slope).all():
            raise OverflowError(
                f"derivatives of the solution exceed the range of floating point at {when(t)}"
            )
        return np.concatenate([coefficients, slope.reshape(*slope.shape[:-2], -1)], axis=-1)

    def _where_finite(self, t: Any, z: Array, arguments: tuple[Any, ...]) -> Array:
        """Return the coefficients at finite points, and NaN at others, which end steps."""
        values = np.full((*z.shape[:-1], self.product.dim), np.nan)
        finite = np.isfinite(z).all(axis=-1)
        if self.vectorized and finite.any():
            if self.count:
                arguments = (*arguments[:-1], arguments[-1][finite])
            values[finite] = self(t[finite], z[finite], *arguments)
        return values

    def coefficients(self, t: Any, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return the coefficients that ``f`` gives at points, after checking them."""
        if isinstance(self.f, CompiledRhs):
            shape = (self.frame.rhs_dim,)
            answer: Array = self._compiled("f", self.f, t, y[None], arguments, shape)[0]
        else:
            answer = self._rhs.check(self.f(t, _read_only(y), *arguments), t, y)
        return self.frame.complete_rhs(answer, y)

    def _adjoint(self, f: Array) -> Array:
        """Return the matrices of brackets with coefficients, shape ``(..., n, n)``."""
        n = self.frame.dim
        if self._constants is not None:
            matrices: Array = (f @ self._constants).reshape(*f.shape, n)
            return matrices
        return self.frame.bracket(f[..., None, :], np.eye(n)).mT

    def jacobian(self, t: Any, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return derivatives of ``f`` along the frame's fields, shape ``(..., n, n)``."""
        n = self.frame.dim
        if self.jac is not None:
            return self._given("jac", self.jac, t, y, arguments, (n, n))
        lead = y.shape[: y.ndim - len(self.frame.point_shape)]
        sizes = DIFFERENCE_STEP * np.maximum(self.frame.coordinate_sizes(y), 1.0)
        v = sizes[..., None, :] * np.concatenate([np.eye(n), -np.eye(n)])
        start = np.broadcast_to(
            y.reshape(*lead, 1, *self.frame.point_shape), (*lead, 2 * n, *self.frame.point_shape)
        )
        values = self._at_points(t, self._flows(v[..., None, :], start, False), arguments)
        differences: Array = values[..., :n, :] - values[..., n:, :]
        return np.asarray(differences.mT / (2.0 * sizes[..., None, :]))

    def _at_points(self, t: Any, points: Points, arguments: tuple[Any, ...]) -> Array:
        """Return coefficients at several points of each member, shape ``(..., points, n)``."""
        n = self.frame.dim
        if isinstance(self.f, CompiledRhs):
            answer = self._compiled("f", self.f, t, points, arguments, (self.frame.rhs_dim,))
            return self.frame.complete_rhs(answer, points)
        if not self.vectorized:
            return np.array([self.coefficients(t, point, arguments) for point in points])
        each = points.shape[1]
        flat = points.reshape(-1, *self.frame.point_shape)
        extra = self._repeated(arguments, each)
        return self.coefficients(np.repeat(t, each), flat, extra).reshape(len(points), each, n)

    def _repeated(self, arguments: tuple[Any, ...], each: int) -> tuple[Any, ...]:
        """Return arguments whose rows of parameters are repeated for several points."""
        if not self.count:
            return arguments
        return (*arguments[:-1], np.repeat(arguments[-1], each, axis=0))

    def parameter_derivative(self, t: Any, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return derivatives of ``f`` with respect to parameters, shape ``(..., n, k)``."""
        if self.df_dp is not None:
            return self._given("df_dp", self.df_dp, t, y, arguments, (self.frame.dim, self.count))
        columns = []
        for moved, size in parameter_steps(arguments[-1], DIFFERENCE_STEP):
            ahead, behind = (
                self.coefficients(t, y, (*arguments[:-1], row)) for row in (moved(1.0), moved(-1.0))
            )
            columns.append((ahead - behind) / (2.0 * size[..., None]))
        return np.stack(columns, axis=-1)

    def _given(
        self,
        name: str,
        function: Function,
        t: Any,
        y: Points,
        arguments: tuple[Any, ...],
        shape: tuple[int, ...],
    ) -> Array:
        """Return the value of a function of the user, after checking it."""
        if isinstance(function, CompiledRhs):
            value: Any = self._compiled(name, function, t, y[None], arguments, shape)[0]
        else:
            value = function(t, _read_only(y), *arguments)
        return self._checked(name, value, t, shape)

    def _checked(self, name: str, value: Any, t: Any, shape: tuple[int, ...]) -> Array:
        """Return the value of a function of the user as a C-ordered array, after checking it."""
        expected = (len(t), *shape) if self.vectorized else shape
        if not is_array(value, np.float64):
            try:
                value = real_array(value if value is not None else "None", name)
            except ValueError as error:
                raise ValueError(
                    f"{name} must return an array of shape {expected}, got {value!r} at {when(t)}"
                ) from error
        if value.shape != expected:
            raise ValueError(
                f"{name} must return an array of shape {expected}, got shape {value.shape} at "
                f"{when(t)}"
            )
        if not math.isfinite(value.sum()) and not np.isfinite(value).all():
            raise ValueError(f"{name} must return finite numbers, got {value} at {when(t)}")
        return np.ascontiguousarray(value)

    def data_address(self, arguments: tuple[Any, ...]) -> int:
        """Return the address of the data of compiled functions without data of their own."""
        if self.count:
            return int(arguments[-1].ctypes.data)
        return self.f.user_data if isinstance(self.f, CompiledRhs) else 0

    def _compiled(
        self,
        name: str,
        function: CompiledRhs,
        t: float,
        y: Points,
        arguments: tuple[Any, ...],
        shape: tuple[int, ...],
    ) -> Array:
        """Return the values of a compiled function at several points of one member."""
        import cg._core_r64 as core

        points = np.array(y, dtype=self.frame.dtype, order="C").reshape(len(y), -1)
        values = np.full((len(y), math.prod(shape)), np.nan)
        data = function.user_data or self.data_address(arguments)
        rows = points.view(np.float64)
        _, code = core.call_field(function.address, data, 0, t, rows.T, values.T)
        if code:
            raise RuntimeError(f"{name} returned the error code {code} at {when(t)}")
        if not np.isfinite(values).all() and np.isfinite(rows).all():
            raise ValueError(f"{name} must return finite numbers, got {values[0]} at {when(t)}")
        return values.reshape(len(y), *shape)


def parameter_steps(row: Array, step: float) -> list[tuple[Any, Array]]:
    """Return for each parameter a function that shifts it by some steps, and the step size.

    Parameters have the shape ``(..., k)``.  ``step`` is relative to the parameter, or to one if it
    is zero.
    """
    steps_of = []
    for i in range(row.shape[-1]):
        size = step * np.where(row[..., i] == 0.0, 1.0, np.abs(row[..., i]))

        def moved(steps: float, i: int = i, size: Array = size) -> Array:
            other = row.copy()
            other[..., i] += steps * size
            return other

        steps_of.append((moved, np.asarray(size)))
    return steps_of


def _constants(frame: Frame) -> Array | None:
    """Return structure constants [i, k n + j], empty if all are zero; None if there are too many.

    Those of ``[E_i, E_j]`` along ``E_k``.
    """
    n = frame.dim
    if n > MAX_CONSTANTS:
        return None
    basis = np.eye(n)
    constants = frame.bracket(basis[:, None], basis)
    if not constants.any():
        return np.empty(0)
    return np.ascontiguousarray(constants.mT).reshape(n, n * n)


def _read_only(y: Points) -> Points:
    view = y.view()
    view.flags.writeable = False
    return view
