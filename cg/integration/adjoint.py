r"""Gradients of costs of solutions by the adjoint equation.

Derivatives of a solution satisfy :math:`\xi' = A \xi + B` for each parameter. The derivative of a
cost with respect to the point at time t is a covector :math:`\lambda`, which satisfies
:math:`\lambda' = -A^H \lambda` between output times and goes backward from the end. Its value at
the start is the gradient with respect to the initial point, and :math:`\int \lambda^H B\,dt` that
with respect to the parameters.

The steps of the integration are divided at output times, and bisected where that is needed. On
each interval the adjoint equation is solved by collocation at Gauss's nodes, of order twelve, from
unit covectors, for many intervals at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Legendre
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points, check_finite, complex_array, real_array
from cg.integration.loop.dense import DenseOutput
from cg.integration.problem import Problem
from cg.integration.results import EnsembleSolution, Solution

ADJOINT = "adjoint"
_COUNT = 6
_X, _W = np.polynomial.legendre.leggauss(_COUNT)
_NODES, _WEIGHTS = (_X + 1) / 2, _W / 2
# of values at the nodes to coefficients of Legendre polynomials
_TO_LEGENDRE = np.array([(2 * k + 1) * _WEIGHTS * Legendre.basis(k)(_X) for k in range(_COUNT)])
# entry [j, l]: the integral of the l-th Lagrange polynomial from node j to 1
_INTEGRALS = (
    np.stack([1 - _NODES ** (k + 1) for k in range(_COUNT)], axis=1) / np.arange(1, _COUNT + 1)
) @ np.linalg.inv(np.vander(_NODES, increasing=True))
_BISECTIONS = 20
_MIXED = 8
_LARGEST_NORM = 1e5  # the number of intervals is proportional to it
_FIXED_STEPS = 1e-12  # tolerance where the integration had none
_ENTRIES = 1 << 22  # of the matrices that are solved at a time


class Gradient(NamedTuple):
    """The derivatives of a cost.

    Attributes
    ----------
    y0
        With respect to the coordinates of the initial point, shape ``(dim,)``; on
        `cg.frames.LinearAction` with respect to its entries, shape ``frame.point_shape``.
    parameters
        With respect to the parameters, shape ``(k,)``, or None without any.
    """

    y0: Points
    parameters: Array | None


@dataclass(frozen=True, eq=False)
class Equation:
    """The equation of derivatives of a solution, and of covectors."""

    # A and B at times, shapes (times, n, n) and (times, m, k); B is None without parameters
    at: Callable[[Array], tuple[Points, Array | None]]
    shape: tuple[int, ...]  # of a covector
    tolerance: float
    parameters: int | None = None  # their number, None without any
    # of a linear equation y' = A y: A = sum_m a_m G_m, where B are the derivatives of the a_m
    generators: Points | None = None
    skew: bool = False  # whether its matrices are skew-Hermitian
    output: DenseOutput | None = None  # its solution

    def integral(self, part: _Intervals, ends: Points) -> Array:
        """Return the derivatives by the parameters from intervals and covectors at their ends."""
        paired = part.maps[:, 1:] @ ends[:, None]
        if self.generators is not None:
            moved = self.generators @ part.points[:, :, None]
            paired = np.sum(paired[:, :, None].conj() * moved, axis=-2).real.sum(-1)
        b = part.by_parameters
        weighted = (part.size[:, None] * _WEIGHTS)[..., None] * paired.reshape(b.shape[:-1])
        return np.asarray(np.einsum("ijm,ijmk->k", weighted, b))


class _Intervals(NamedTuple):
    start: Array
    size: Array  # signed
    maps: Points  # from the covector at the end to those at the start and the nodes
    by_parameters: Array  # B at the nodes, shape (intervals, nodes, m, k)
    points: Points  # of a linear equation at the nodes, shape (intervals, nodes, n, columns)


def _collocate(matrix: Points, size: Array) -> tuple[Points, Array]:
    """Return maps of covectors from the end of intervals, and estimates of the errors at starts.

    The matrices have the shape ``(intervals, nodes, n, n)``, the maps ``(intervals, 1 + nodes, n,
    n)``; the first one is that to the start.
    """
    count, n = len(matrix), matrix.shape[-1]
    adjoint = size[:, None, None, None] * matrix.conj().mT
    system = -_INTEGRALS[:, None, :, None] * adjoint.swapaxes(1, 2)[:, None]
    system = system.reshape(count, _COUNT * n, _COUNT * n) + np.eye(_COUNT * n)
    units = np.tile(np.eye(n), (_COUNT, 1))
    at_nodes = np.linalg.solve(system, np.broadcast_to(units, (count, *units.shape)))
    at_nodes = at_nodes.reshape(count, _COUNT, n, n)
    slopes = adjoint @ at_nodes
    start = np.eye(n) + np.tensordot(_WEIGHTS, slopes, (0, 1))
    return np.concatenate([start[:, None], at_nodes], axis=1), _unresolved(slopes) ** 2


def _unresolved(values: Points) -> Array:
    """Return an estimate of the first coefficient that polynomials through the nodes leave out.

    Values have the shape ``(intervals, nodes, ...)``. The error of collocation is about its square,
    since it is multiplied by that of the solution.
    """
    size = np.abs(np.tensordot(_TO_LEGENDRE, values, (1, 1))).max(axis=(2, 3))
    low, high = size[-4:-2].max(axis=0), size[-2:].max(axis=0)
    estimate: Array = high * np.minimum(high / np.maximum(low, np.finfo(float).tiny), 1.0)
    return estimate


def _solve(equation: Equation, edges: Array) -> list[_Intervals]:
    """Return the intervals between times, bisected until the estimates are below the tolerance.

    They aren't sorted.
    """
    start, size = edges[:-1], np.diff(edges)
    parts: list[_Intervals] = []
    for bisection in range(_BISECTIONS + 1):
        again: list[Array] = []
        n = equation.shape[0]
        each = max(1, _ENTRIES // (_COUNT * n) ** 2)
        for first in range(0, len(start), each):
            chunk = slice(first, first + each)
            part, errors = _at(equation, start[chunk], size[chunk])
            good = errors <= equation.tolerance
            if bisection == _BISECTIONS:
                good[:] = True
            parts.append(part if good.all() else _Intervals(*(a[good] for a in part)))
            again.append(np.stack([start[chunk][~good], size[chunk][~good]]))
        start, size = np.concatenate(again, axis=1)
        if not start.size:
            break
        size = np.tile(size / 2, 2)
        start = np.concatenate([start, start + size[: len(start)]])
    return parts


def _at(equation: Equation, start: Array, size: Array) -> tuple[_Intervals, Array]:
    """Return intervals with estimates of their errors."""
    times = start[:, None] + size[:, None] * _NODES
    matrix, b = equation.at(times.ravel())
    matrix = matrix.reshape(*times.shape, *matrix.shape[1:])
    norms = np.abs(size[:, None] * np.abs(matrix).sum(axis=-1).max(axis=-1)).max(axis=1)
    if not norms.sum() <= _LARGEST_NORM:
        raise ValueError(
            "derivatives must not be 'adjoint' for an equation that is this stiff: the integral of "
            f"the norm of its Jacobian is {norms.sum():.2g}, more than {_LARGEST_NORM:.0g}"
        )
    maps, errors = _collocate(matrix, size)
    points = np.empty((len(start), 0))
    if b is None:
        return _Intervals(start, size, maps, points, points), errors
    b = b.reshape(*times.shape, *b.shape[1:])
    mixed = b @ _mixture(b.shape[-1])
    largest = max(np.abs(mixed).max(), np.finfo(float).tiny)
    errors = np.maximum(errors, (_unresolved(mixed) / largest) ** 2)
    if equation.output is not None:
        output = equation.output
        own = maps if equation.skew else _collocate(-matrix.conj().mT, size)[0]
        ends = output(np.clip(start + size, output.t_min, output.t_max))
        points = own[:, 1:] @ ends.reshape(len(start), 1, matrix.shape[-1], -1)
    return _Intervals(start, size, maps, b, points), errors


@cache
def _mixture(count: int) -> Array:
    """Return random combinations of the parameters, whose errors stand for those of all."""
    if count <= _MIXED:
        return np.eye(count)
    return np.random.default_rng(0).standard_normal((count, _MIXED))


@dataclass(frozen=True, eq=False, repr=False)
class AdjointSolution(Solution):
    """A `Solution` whose costs have gradients: with ``derivatives="adjoint"``.

    Examples
    --------
    The derivative of the first coordinate of an oscillator after one second, with respect to its
    initial point and its stiffness:

    >>> import crouch_grossman as cg
    >>> solution = cg.solve_variational(
    ...     lambda t, y, p: [y[1], -p[0] * y[0]], (0, 1), [1.0, 0.0], frame=cg.frames.Euclidean(2),
    ...     parameters=[1.0], derivatives="adjoint", rtol=1e-10, atol=1e-10,
    ... )
    >>> gradient = solution.gradient([1.0, 0.0])
    >>> gradient.y0.round(6), gradient.parameters.round(6)
    (array([0.540302, 0.841471]), array([-0.420735]))
    """

    _equation: Equation = field(kw_only=True)
    _output: DenseOutput = field(kw_only=True)

    def gradient(self, cotangent: ArrayLike) -> Gradient:
        """Return the derivatives of a cost by the initial point and the parameters.

        Parameters
        ----------
        cotangent
            Derivatives of the cost with respect to the last point along the frame's fields, shape
            ``(dim,)``, or with respect to all ``y``, shape ``(len(t), dim)``. On
            `cg.frames.LinearAction` they are with respect to entries of points, shape
            ``frame.point_shape`` in place of ``(dim,)``: c if the cost changes by the real part of
            ``vdot(c, dy)``.

        Returns
        -------
        Gradient
            ``y0`` and ``parameters``.

        Raises
        ------
        ValueError
            If the cotangent has another shape or isn't finite; or if the equation is stiff, so that
            a hundred thousand intervals would be needed.

        Notes
        -----
        The first call evaluates f and its derivatives at six points of each step, and solves for
        the covectors; others take little time.
        """
        given, equation = self._read(cotangent), self._equation
        if self.t[-1] == self._output.ts[0]:
            count = equation.parameters
            start: Points = given.sum(axis=0).reshape(equation.shape)
            return Gradient(start, None if count is None else np.zeros(count))
        parts = self._parts
        starts = self._sign * np.concatenate([part.start for part in parts])
        order = np.argsort(starts)
        steps = np.concatenate([part.maps[:, 0] for part in parts])[order]
        count = len(starts)
        covector = np.zeros_like(given[0])
        ends = np.empty((count, *covector.shape), given.dtype)
        at = np.searchsorted(starts[order], self._sign * self.t).tolist()
        for i in range(count, -1, -1):
            while at and at[-1] == i:
                covector = covector + given[len(at) - 1]
                at.pop()
            if i:
                ends[order[i - 1]] = covector
                covector = steps[i - 1] @ covector
        by_parameters = None
        if equation.parameters is not None:
            last = np.cumsum([len(part.start) for part in parts])
            integrals = map(equation.integral, parts, np.split(ends, last[:-1]))
            by_parameters = np.sum(list(integrals), axis=0)
        return Gradient(covector.reshape(equation.shape), by_parameters)

    def _read(self, cotangent: ArrayLike) -> Points:
        """Return the cotangents at all times, shape ``(times, n, columns)``."""
        shape, times = self._equation.shape, len(self.t)
        generators = self._equation.generators
        is_complex = generators is not None and generators.dtype.kind == "c"
        array: Points = (complex_array if is_complex else real_array)(cotangent, "cotangent")
        check_finite(array, "cotangent")
        if array.shape not in (shape, (times, *shape)):
            raise ValueError(
                f"cotangent must have shape {shape} or {(times, *shape)}, got {array.shape}"
            )
        given = np.zeros((times, *shape), array.dtype)
        given[... if array.ndim > len(shape) else -1] = array
        return given.reshape(times, shape[0], -1)

    @property
    def _sign(self) -> float:
        return 1.0 if self._output.ts[-1] >= self._output.ts[0] else -1.0

    @cached_property
    def _parts(self) -> list[_Intervals]:
        """The solved intervals from the first point to the last one that is stored."""
        edges = self._sign * np.concatenate([self._output.ts, self.t])
        edges = np.unique(edges[edges <= self._sign * self.t[-1]])
        return _solve(self._equation, self._sign * edges)


@dataclass(frozen=True, eq=False)
class AdjointMaker:
    """Makes solutions that have gradients of those that don't."""

    equation_of: Callable[[DenseOutput], Equation]
    dense: bool  # whether the user asked for the continuous solution

    def __call__(self, _: Problem, fields: dict[str, Any]) -> EnsembleSolution:
        """Return the solution with the fields of an `EnsembleSolution`."""
        return _AdjointMembers(**fields, maker=self)


@dataclass(frozen=True, eq=False, repr=False)
class _AdjointMembers(EnsembleSolution):
    maker: AdjointMaker = field(kw_only=True)

    def __getitem__(self, member: int) -> AdjointSolution:
        fields = self._fields_of(member)
        output = fields["sol"]
        if not self.maker.dense:
            fields["sol"] = None
        equation = self.maker.equation_of(output)
        return AdjointSolution(**fields, _equation=equation, _output=output)


def with_adjoint(problem: Problem, equation_of: Callable[[DenseOutput], Equation]) -> Problem:
    """Return the problem whose solution has gradients, after checking that it can have them."""
    if problem.events is not None:
        raise ValueError(
            "events must be None with derivatives='adjoint', which doesn't go through their jumps "
            "and ends"
        )
    maker = AdjointMaker(equation_of, problem.dense)
    return replace(problem, dense=True, make_solution=maker)


def tolerance_of(problem: Problem) -> float:
    """Return the tolerance of the adjoint equation."""
    return (
        _FIXED_STEPS if problem.control.h is not None else 0.1 * float(np.min(problem.control.rtol))
    )


def check_derivatives(derivatives: Any) -> bool:
    """Return whether derivatives are those of the adjoint equation."""
    if derivatives is not None and not (isinstance(derivatives, str) and derivatives == ADJOINT):
        raise ValueError(f"derivatives must be None or 'adjoint', got {derivatives!r}")
    return derivatives == ADJOINT
