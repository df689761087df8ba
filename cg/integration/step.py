"""One step of a method, explicit or implicit, in Python."""

from __future__ import annotations

import math

import numpy as np

from cg.conditions import Rows
from cg.frames.arrays import Array, Points
from cg.frames.base import FlowOverflowError, Frame
from cg.integration.error_norm import ErrorNorm
from cg.integration.flows import dexpinv_of, flows_of
from cg.integration.implicit import DEFAULT_STAGE_SOLVER, Row, StageSolver, check_stage_solver
from cg.integration.paths import paths_of
from cg.integration.python_rhs import (
    Coefficients,
    PythonRhs,
    StageOverflowError,
    StepTooLongError,
)
from cg.integration.stepper import Counts, advances_by_embedded
from cg.method import Method
from cg.tableau import Tableau

__all__ = ["Step"]


class Step:
    r"""One step of a method, prepared for many repetitions.

    An explicit method follows the paths of its tree of points, with :math:`F_k` the field whose
    coefficients are frozen at stage :math:`k`,

    .. math:: y_m = \exp\Bigl(h \sum_k \alpha_{m,k} F_k\Bigr) y_{\mathrm{parent}(m)} .

    An implicit one is equation (2.3) of [1]_.  Of a pair the result of higher order makes the
    step.  Steps on a Lie algebra are those of `cg.MuntheKaas`.

    Parameters
    ----------
    f
        ``f(t, y)`` returns the coefficients, shape ``(*batch, frame.dim)``; it is given a
        read-only ``y`` of shape ``(*batch, *frame.point_shape)``.  Or a `PythonRhs`.
    frame
        The frame that holds the points and supplies the flows.
    method
        The method.
    batch
        Leading axes of the points.
    stage_solver
        How implicit stages are solved, one of `cg.integration.implicit.STAGE_SOLVERS`.

    Attributes
    ----------
    counts
        What the steps took so far.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.
    """

    def __init__(
        self,
        f: Coefficients | PythonRhs,
        frame: Frame,
        method: Method,
        *,
        batch: tuple[int, ...] = (),
        stage_solver: str = DEFAULT_STAGE_SOLVER,
    ) -> None:
        check_stage_solver(stage_solver)
        self.rhs = f if isinstance(f, PythonRhs) else PythonRhs(f, frame, batch)
        self.frame = frame
        self.flows = flows_of(frame)
        self.method = method
        self.batch = batch
        self.abscissae: list[float] = method.c.tolist()
        self.counts = Counts()
        self._known: tuple[float, Points, Array] | None = None
        self._final: tuple[Points, Array] | None = None
        self.solvers: list[StageSolver] | None = None
        self.series = 0
        self.error_weights = np.empty((0, 0))
        if isinstance(method, Tableau) and not method.explicit:
            self._prepare_rows(method, stage_solver)
        else:
            self._prepare_paths()

    def _prepare_paths(self) -> None:
        paths = paths_of(self.method)
        self.results = [paths.result, paths.embedded]
        self.stage_paths = paths.stages
        self.final_stage = paths.final_stage
        self.series = paths.series
        if self.series:
            self.dexpinv = dexpinv_of(self.frame, self.series)
            self._coordinates: dict[int, Array] = {}
        self.error_weights = np.array(paths.errors, dtype=np.float64)
        self.paths = []
        for path in paths.paths:
            stages = sorted({stage for flow in path.flows for stage, _ in flow})
            rows = [[float(dict(flow).get(k, 0)) for k in stages] for flow in path.flows]
            self.paths.append((path.origin, stages, np.array(rows)))

    def _prepare_rows(self, method: Tableau, stage_solver: str) -> None:
        self.rows = [_nonzero(row) for row in method.a]
        weights = [_nonzero(row) for row in (method.b, method.b_embedded) if row is not None]
        if advances_by_embedded(method):
            weights.reverse()
        self.weights = weights
        stages = range(len(self.rows))
        blocks = [list(stages)] if method.rows is Rows.FULL else [[i] for i in stages]
        self.solvers = [StageSolver(self, block, stage_solver) for block in blocks]

    def __call__(self, t: float, point: Points, h: float) -> Points:
        """Return the point after a step of size ``h`` from ``point`` at time ``t``."""
        return self._take(t, point, h, 1)[0]

    def pair(self, t: float, point: Points, h: float) -> tuple[Points, Points]:
        """Return the point after a step, and the result of lower order.

        Raises
        ------
        ValueError
            If the method is no pair.
        """
        if self.method.embedded_order is None:
            raise ValueError(f"method must have embedded weights, got {self.method!r}")
        if self.error_weights.size and not self.series:
            (result,) = self._take(t, point, h, 1)
            difference = -h * (self.error_weights[0] @ self._stage_fields)
            return result, self.frame.flow(difference, result)
        result, other = self._take(t, point, h, 2)
        return result, other

    def trial(
        self, t: float, point: Points, h: float, norm: ErrorNorm
    ) -> tuple[Points | None, float]:
        """Return the point after a step of a pair, and its error in tolerances.

        The point is None where there is no error that is finite.
        """
        if self.error_weights.size:
            (reached,) = self._take(t, point, h, 1)
            differences = _combined(h * self.error_weights, self._stage_fields)
            if not np.isfinite(reached).all() or not np.isfinite(differences).all():
                return None, math.inf
            error = norm.estimate(np.moveaxis(differences, -2, 0), reached, point)
        else:
            reached, other = self.pair(t, point, h)
            if not (np.isfinite(reached).all() and np.isfinite(other).all()):
                return None, math.inf
            error = norm.error(reached, other, point)
        return (reached, error) if math.isfinite(error) else (None, math.inf)

    def _take(self, t: float, point: Points, h: float, results: int) -> list[Points]:
        fields = np.empty((*self.batch, len(self.abscissae), self.frame.dim))
        if self.solvers is not None:
            fields[...] = self.field(t, point)[..., None, :]
            for solver in self.solvers:
                solver(t, point, h, fields)
            return [self.compose(row, fields, point, h) for row in self.weights[:results]]
        known = {0: point}
        fields[..., 0, :] = self.field(t, point)
        for k, c in enumerate(self.abscissae[1:], start=1):
            stage = self._end(self.stage_paths[k], known, fields, h)
            last = self.evaluate(t + c * h, stage)
            fields[..., k, :] = self._derivative(self.stage_paths[k], last, t)
            if k == self.final_stage - 1:
                final = last
        found = [self._end(path, known, fields, h) for path in self.results[:results]]
        if self.final_stage:  # the first of the next step, which starts from this very object
            self._final = found[0], final
        self._stage_fields = fields
        return found

    def _derivative(self, path: int, field: Array, t: float) -> Array:
        """Return the coefficients at the end of a path, on a Lie algebra those of coordinates."""
        if not self.series or path == 0:
            return field
        found = self.dexpinv(self._coordinates[path], field)
        if not np.isfinite(found).all():
            raise StepTooLongError(t)
        return found

    def _end(self, path: int, known: dict[int, Points], fields: Array, h: float) -> Points:
        """Return the end of a path, after those on the way to it."""
        if path not in known:
            origin, stages, weights = self.paths[path - 1]
            start = self._end(origin, known, fields, h)
            self.counts.nexp += len(weights)
            v = _combined(h * weights, fields[..., stages, :])
            if self.series:
                self._coordinates[path] = v[..., 0, :]
            known[path] = self._move(v, start, path in self.results)
        return known[path]

    def field(self, t: float, point: Points) -> Array:
        """Return f(t, point), without evaluating it again if it is known.

        It is if that was the last such call, or if the last stage of a step was there.

        Points are told apart as objects, so ``point`` must not be changed in between.
        """
        if self._final is not None and self._final[0] is point:
            self._known = (t, *self._final)
        elif self._known is None or self._known[1] is not point or self._known[0] != t:
            self._known = (t, point, self.evaluate(t, point))
        return self._known[2]

    def end_member(self, index: tuple[int, ...]) -> None:
        """Leave a member of an ensemble where it is from now on."""
        self.rhs.ended[index] = True
        self._known = self._final = None

    def compose(self, row: Row, fields: Array, point: Points, h: float) -> Points:
        """Apply the flows of a row of coefficients, that of the lowest stage first."""
        self.counts.nexp += len(row)
        if not row:
            return point
        stages = [j for j, _ in row]
        weights = np.array([h * weight for _, weight in row])
        return self._move(weights[:, None] * fields[..., stages, :], point)

    def _move(self, v: Array, point: Points, restore: bool = True) -> Points:
        try:
            return self.flows(v, point, restore)
        except FlowOverflowError as error:
            # An adaptive step is tried again with a smaller size, unlike where f itself overflows.
            raise StageOverflowError(str(error)) from error

    def evaluate(self, t: float, point: Points) -> Array:
        """Return f(t, point) after checking it."""
        self.counts.nfev += 1
        return self.rhs(t, point)


def _nonzero(row: Array) -> Row:
    return tuple((j, value) for j, value in enumerate(row.tolist()) if value != 0.0)


def _combined(weights: Array, fields: Array) -> Array:
    """Return the fields of flows, summed over stages in their order, as compiled code does."""
    total = weights[:, 0, None] * fields[..., None, 0, :]
    for k in range(1, weights.shape[1]):
        total = total + weights[:, k, None] * fields[..., None, k, :]
    return np.asarray(total)
