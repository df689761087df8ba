r"""The adjoint equation along a solution, solved on many intervals at a time.

Covectors satisfy :math:`\lambda' = -A^H \lambda`. On each interval the equation is solved by
collocation at Gauss's nodes, of order ten, from unit covectors; intervals are bisected until
estimates of the errors are small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Legendre

from cg.integration.output.solutions import DenseOutput
from cg.integration.rhs.inputs import Inputs
from cg.support.arrays import Array, Points

_COUNT = 5  # nodes of an interval, where collocation has order ten
_X, _W = np.polynomial.legendre.leggauss(_COUNT)
_NODES, _WEIGHTS = (_X + 1) / 2, _W / 2
# the matrix from values at the nodes to coefficients of Legendre polynomials
_TO_LEGENDRE = np.array([(2 * k + 1) * _WEIGHTS * Legendre.basis(k)(_X) for k in range(_COUNT)])
# entry [j, l]: the integral of the l-th Lagrange polynomial from node j to 1
_INTEGRALS = (
    np.stack([1 - _NODES ** (k + 1) for k in range(_COUNT)], axis=1) / np.arange(1, _COUNT + 1)
) @ np.linalg.inv(np.vander(_NODES, increasing=True))
_MAX_BISECTIONS = 20  # largest number of bisections of an interval
_MAX_INTEGRAL = 1e5  # integral of an eigenvalue, to which the number of intervals is proportional
_MAX_UNRESOLVED = 8  # largest number of unresolved intervals per edge, of `solve_intervals`
_MIN_BISECTED = 64  # units of rounding of time in an interval that can be bisected
_NOISE_SAMPLES = 8  # of unresolved intervals, whose derivatives are compared at neighbouring times
_FAR = 1e4  # size of unresolved intervals, relative to the distance of these times
_SAME_EDGE = 8  # units of rounding between edges that coincide: nodes may round to either side
_ENTRIES = 1 << 22  # numbers in the matrices that are solved at a time


class Gradient(NamedTuple):
    """The derivatives of a cost, or of several numbers along first axes.

    Attributes
    ----------
    y0
        With respect to the coordinates of the initial point, shape ``(dim,)``; on
        `cg.frames.LinearAction` with respect to its entries, shape ``frame.point_shape``.
    parameters
        With respect to the parameters, shape ``(k,)``, or None without any.
    inputs
        With respect to the values of ``inputs``, in their shape, or a tuple of these as ``inputs``
        are; None without any.
    """

    y0: Points
    parameters: Array | None
    inputs: Array | tuple[Array, ...] | None = None


@dataclass(frozen=True, eq=False)
class AdjointEquation:
    """The adjoint equation of a solution, with the functions A and B of time."""

    # A and B at times, shapes (times, n, n) and (times, m, k); B is None without parameters and
    # inputs, which are the last of the k
    at: Callable[[Array], tuple[Points, Array | None]]
    shape: tuple[int, ...]  # shape of a covector
    tolerance: float
    parameters: int | None = None  # number of parameters, None without any
    inputs: Inputs | None = None
    # A linear equation y' = A y has A = sum_m a_m G_m, and B are the derivatives of the a_m.
    generators: Points | None = None
    skew: bool = False  # whether the matrices G_m are skew-Hermitian
    output: DenseOutput | None = None  # solution of the linear equation

    def gradient(self, start: Points, chunks: list[Intervals], ends: Points) -> Gradient:
        """Return the gradient from covectors at the first point and at the ends of intervals."""
        y0, inputs = start.reshape(self.shape), self.inputs
        if self.parameters is None and inputs is None:
            return Gradient(y0, None)
        splits = np.cumsum([len(intervals.start) for intervals in chunks])[:-1]
        integrals = map(self._integrals, chunks, np.split(ends, splits))
        by_parameters, by_inputs = zip(*integrals, strict=True)
        total = None if self.parameters is None else np.sum(by_parameters, axis=0)
        if inputs is None:
            return Gradient(y0, total)
        times = np.concatenate([intervals.times.ravel() for intervals in chunks])
        return Gradient(y0, total, inputs.by_values(times, np.concatenate(by_inputs)))

    def _integrals(self, intervals: Intervals, ends: Points) -> tuple[Array, Array]:
        """Return integrals of derivatives by the parameters, and terms of integrals by the inputs.

        The terms belong to nodes, shape (intervals * nodes, width).
        """
        covectors = intervals.maps[:, 1:] @ ends[:, None]
        if self.generators is not None:
            tangents = self.generators @ intervals.points[:, :, None]
            covectors = np.sum(covectors[:, :, None].conj() * tangents, axis=-2).real.sum(-1)
        m, k = intervals.by_parameters.shape[-2:]
        count, b = self.parameters or 0, intervals.by_parameters.reshape(-1, m, k)
        weights = (intervals.size[:, None] * _WEIGHTS).reshape(-1, 1)
        weighted = weights * covectors.reshape(-1, m)
        by_parameters = weighted.ravel() @ b[..., :count].reshape(len(b) * m, count)
        return by_parameters, np.einsum("im,imk->ik", weighted, b[..., count:])


class Intervals(NamedTuple):
    """Solved intervals, with maps of covectors and what the integrals of gradients need."""

    start: Array
    size: Array  # signed
    maps: Points  # from the covector at the end to those at the start and the nodes
    by_parameters: Array  # B at the nodes, shape (intervals, nodes, m, k)
    points: Points  # at the nodes, for a linear equation; shape (intervals, nodes, n, columns)

    @property
    def times(self) -> Array:
        """The times of the nodes, shape (intervals, nodes)."""
        return self.start[:, None] + self.size[:, None] * _NODES


def _collocate(matrix: Points, size: Array) -> tuple[Points, Array]:
    """Return maps of covectors from the end of intervals, and estimates of the errors at starts.

    The matrices have the shape ``(intervals, nodes, n, n)``, the maps ``(intervals, 1 + nodes, n,
    n)``; the first map of an interval leads to its start, the others to its nodes.
    """
    count, n = len(matrix), matrix.shape[-1]
    adjoint = size[:, None, None, None] * matrix.conj().mT
    system: Points = np.empty((count, _COUNT, n, _COUNT, n), adjoint.dtype)
    np.multiply(-_INTEGRALS[:, None, :, None], adjoint.swapaxes(1, 2)[:, None], out=system)
    system = system.reshape(count, _COUNT * n, _COUNT * n)
    system.reshape(count, -1)[:, :: _COUNT * n + 1] += 1.0
    units = np.tile(np.eye(n), (_COUNT, 1))
    at_nodes = np.linalg.solve(system, np.broadcast_to(units, (count, *units.shape)))
    at_nodes = at_nodes.reshape(count, _COUNT, n, n)
    slopes = adjoint @ at_nodes
    start = np.eye(n) + np.tensordot(_WEIGHTS, slopes, (0, 1))
    return np.concatenate([start[:, None], at_nodes], axis=1), _unresolved(slopes) ** 2


def _unresolved(values: Points) -> Array:
    """Return an estimate of the first coefficient that polynomials through the nodes leave out.

    Values have the shape ``(intervals, nodes, ...)``. The error of collocation is about the square
    of the estimate: it is the product of the errors of both the slopes and the solution.
    """
    size = np.abs(np.tensordot(_TO_LEGENDRE, values, (1, 1))).max(axis=(2, 3))
    low, high = size[-4:-2].max(axis=0), size[-2:].max(axis=0)
    return np.asarray(high * np.minimum(high / np.maximum(low, np.finfo(float).tiny), 1.0))


def solve_intervals(equation: AdjointEquation, edges: Array) -> list[Intervals]:
    """Return the intervals between times, bisected until the estimates are below the tolerance.

    They aren't sorted. ValueError is raised if bisection doesn't reach the tolerance, or can't.
    """
    start, size = edges[:-1], np.diff(edges)
    span = abs(edges[-1] - edges[0])
    chunks: list[Intervals] = []
    chunk_size = max(1, _ENTRIES // (_COUNT * equation.shape[0]) ** 2)
    for _ in range(_MAX_BISECTIONS + 1):
        unresolved: list[Array] = []
        for first in range(0, len(start), chunk_size):
            chunk = slice(first, first + chunk_size)
            intervals, errors = _solve_once(equation, start[chunk], size[chunk], span)
            least = _SAME_EDGE * np.spacing(np.abs(intervals.start))
            resolved = (errors <= equation.tolerance) | (np.abs(size[chunk]) <= least)
            if not resolved.all():
                intervals = Intervals(*(array[resolved] for array in intervals))
            chunks.append(intervals)
            unresolved.append(np.stack([start[chunk][~resolved], size[chunk][~resolved]]))
        start, size = np.concatenate(unresolved, axis=1)
        if not start.size:
            return chunks
        _raise_if_noisy(equation, start, size)
        too_short = np.abs(size) < _MIN_BISECTED * np.spacing(np.abs(start))
        if start.size > max(_MAX_INTEGRAL, _MAX_UNRESOLVED * len(edges)) or too_short.any():
            break
        size = np.tile(size / 2, 2)
        start = np.concatenate([start, start + size[: len(start)]])
    raise ValueError(
        "f must be smooth between breakpoints with derivatives='adjoint': its derivatives aren't "
        f"resolved at t = {start[0]:.17g} by intervals of {abs(size[0]):.2g}; name known times of "
        "jumps as breakpoints; gradients don't go through jumps at points of the solution"
    )


def _raise_if_noisy(equation: AdjointEquation, start: Array, size: Array) -> None:
    """Raise ValueError if B changes between neighbouring times, at which bisection wouldn't end.

    Times are neighbours if bisection has far to go from the unresolved intervals down to them.
    """
    apart = _MIN_BISECTED * np.spacing(np.abs(start))
    if start.size < _NOISE_SAMPLES or (np.abs(size) < _FAR * apart).any():  # there may be jumps
        return
    some = slice(None, None, start.size // _NOISE_SAMPLES)
    times = (start + size / 2)[some]
    near, far = (equation.at(at)[1] for at in (times, times + apart[some]))
    if near is None or far is None:
        return
    change = np.abs(far - near).max(axis=(1, 2)) / max(np.abs(near).max(), np.finfo(float).tiny)
    if np.median(change) > np.sqrt(equation.tolerance):
        raise ValueError(
            "f must have accurate derivatives with derivatives='adjoint': those by parameters or "
            f"inputs change by {np.median(change):.1g} of the largest one between neighbouring "
            f"times near t = {times[0]:.6g}; differences have few digits near singular matrices"
        )


def _solve_once(
    equation: AdjointEquation, start: Array, size: Array, span: float
) -> tuple[Intervals, Array]:
    """Return solved intervals with estimates of their errors.

    Errors of maps add up over the span, so that the estimate for an interval is that of the whole
    span divided into intervals like it. Errors of integrals are relative to the largest integrand.
    """
    times = start[:, None] + size[:, None] * _NODES
    matrix, b = equation.at(times.ravel())
    matrix = matrix.reshape(*times.shape, *matrix.shape[1:])
    amount = float(np.abs(size) @ np.abs(matrix).sum(axis=-1).max(axis=(1, 2)))
    # norms grow with coordinates that are large, eigenvalues don't
    if _MAX_INTEGRAL < amount < np.inf:
        amount = float(np.abs(size) @ np.abs(np.linalg.eigvals(matrix)).max(axis=(1, 2)))
    if not amount <= _MAX_INTEGRAL:
        raise ValueError(
            "derivatives must not be 'adjoint' for an equation that is this stiff: the integral of "
            f"the largest eigenvalue of its Jacobian is {amount:.2g}, more than {_MAX_INTEGRAL:.0g}"
        )
    maps, errors = _collocate(matrix, size)
    errors = errors * (span / np.maximum(np.abs(size), np.finfo(float).tiny))
    points = np.empty((len(start), 0))
    if b is None:
        return Intervals(start, size, maps, points, points), errors
    b = b.reshape(*times.shape, *b.shape[1:])
    largest = max(np.abs(b).max(), np.finfo(float).tiny)
    errors = np.maximum(errors, (_unresolved(b) / largest) ** 2)
    if (output := equation.output) is not None:
        # y' = A y from the end of each interval; a covector satisfies it too if A is skew
        flows = maps if equation.skew else _collocate(-matrix.conj().mT, size)[0]
        ends = output(np.clip(start + size, output.t_min, output.t_max))
        points = flows[:, 1:] @ ends.reshape(len(start), 1, matrix.shape[-1], -1)
    return Intervals(start, size, maps, b, points), errors
