"""One step of a Crouch-Grossman method, explicit or implicit, of a point or an ensemble."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.conditions import Rows
from cg.frames.base import Array, Frame, Points, real_array
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_group import MatrixGroup
from cg.integration.flows import Row, flows_of
from cg.integration.implicit import (
    DEFAULT_STAGE_SOLVER,
    StageOverflowError,
    StageSolver,
    check_stage_solver,
)
from cg.tableau import Tableau

Coefficients = Callable[..., ArrayLike]


class Step:
    r"""One step of a tableau, prepared for many repetitions.

    With :math:`F_j` the field whose coefficients are frozen at stage :math:`j`, the step is

    .. math::

        Y_i = e^{h a_{is} F_s} \cdots e^{h a_{i1} F_1} p, \qquad
        y = e^{h b_s F_s} \cdots e^{h b_1 F_1} p ,

    equations (2.2) and (2.3) of [1]_.  The flow of the lowest stage is applied first, and a
    coefficient that is exactly zero costs no flow.

    Parameters
    ----------
    f
        ``f(t, y)`` returns the coefficients, shape ``(*batch, frame.dim)``; it is given a
        read-only ``y`` of shape ``(*batch, *frame.point_shape)``.
    frame
        The frame that holds the points and supplies the flows.
    tableau
        The method.
    batch
        Leading axes of the points.
    stage_solver
        How implicit stages are solved, one of `cg.integration.implicit.STAGE_SOLVERS`.

    Attributes
    ----------
    nfev, nexp, njev, nlu
        How many evaluations of ``f``, flows, Jacobians of the stage equations and inversions of
        them there were so far.  Those of an ensemble count once for all its members.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.
    """

    def __init__(
        self,
        f: Coefficients,
        frame: Frame,
        tableau: Tableau,
        *,
        batch: tuple[int, ...] = (),
        stage_solver: str = DEFAULT_STAGE_SOLVER,
    ) -> None:
        check_stage_solver(stage_solver)
        self.f = f
        self.frame = frame
        self.flows = flows_of(frame)
        self.tableau = tableau
        self.batch = batch
        self.abscissae: list[float] = tableau.c.tolist()
        self.rows = [_nonzero(row) for row in tableau.a]
        self.weights = _nonzero(tableau.b)
        self.embedded = None if tableau.b_embedded is None else _nonzero(tableau.b_embedded)
        if self.embedded is not None and (tableau.embedded_order or 0) > tableau.order:
            self.weights, self.embedded = self.embedded, self.weights
        self.solvers = self._solvers(stage_solver)
        self.nfev = self.nexp = self.njev = self.nlu = 0
        self._known: tuple[float, Points, Array] | None = None

    def __call__(self, t: float, point: Points, h: float) -> Points:
        """Return the point after a step of size ``h`` from ``point`` at time ``t``."""
        return self.compose(self.weights, self.stages(t, point, h), point, h)

    def pair(self, t: float, point: Points, h: float) -> tuple[Points, Points]:
        """Return the point after a step by the weights of higher, and by those of lower order.

        Raises
        ------
        ValueError
            If the tableau is no pair.
        """
        if self.embedded is None:
            raise ValueError(f"method must have embedded weights, got {self.tableau!r}")
        fields = self.stages(t, point, h)
        return (
            self.compose(self.weights, fields, point, h),
            self.compose(self.embedded, fields, point, h),
        )

    def stages(self, t: float, point: Points, h: float) -> Array:
        """Return the coefficients at all stages, shape ``(*batch, stages, dim)``."""
        fields = np.empty((*self.batch, len(self.rows), self.frame.dim))
        if self.solvers is not None:
            fields[...] = self.field(t, point)[..., None, :]
            for solver in self.solvers:
                solver(t, point, h, fields)
            return fields
        fields[..., 0, :] = self.field(t, point)
        for i, c in enumerate(self.abscissae[1:], start=1):
            stage = self.compose(self.rows[i], fields, point, h)
            fields[..., i, :] = self.evaluate(t + c * h, stage)
        return fields

    def field(self, t: float, point: Points) -> Array:
        """Return f(t, point), without evaluating it again if that was the last such call.

        Points are told apart as objects, so ``point`` must not be changed in between.
        """
        if self._known is None or self._known[1] is not point or self._known[0] != t:
            self._known = (t, point, self.evaluate(t, point))
        return self._known[2]

    def compose(self, row: Row, fields: Array, point: Points, h: float) -> Points:
        """Apply the flows of a row of coefficients, that of the lowest stage first."""
        self.nexp += len(row)
        return self.flows(row, fields, point, h) if row else point

    def evaluate(self, t: float, point: Points) -> Array:
        """Return f(t, point) after checking it."""
        visible = point.view()
        visible.flags.writeable = False
        self.nfev += 1
        value: Any = self.f(t, visible)
        shape = (*self.batch, self.frame.dim)
        try:
            # This copies, since f may return the same buffer each time.
            coefficients = real_array(value, "f")
        except ValueError as error:
            wanted = f"an array of shape {shape}" if self.batch else f"{shape[0]} real numbers"
            raise ValueError(f"f must return {wanted}, got {value!r} at t = {t:.17g}") from error
        if coefficients.shape != shape:
            raise ValueError(
                f"f must return an array of shape {shape}, "
                f"got shape {coefficients.shape} at t = {t:.17g}"
                f"{self._hint(coefficients.shape[len(self.batch) :])}"
            )
        # Sums are finite only if all their terms are, and take a fraction of the time.
        if not math.isfinite(coefficients.sum()) and not np.isfinite(coefficients).all():
            if not np.isfinite(point).all():
                raise StageOverflowError(f"a stage is no longer finite at t = {t:.17g}")
            raise ValueError(f"f must return finite numbers, got {coefficients} at t = {t:.17g}")
        return coefficients

    def _hint(self, shape: tuple[int, ...]) -> str:
        """Return what to do if ``f`` returned an element of the Lie algebra as a matrix."""
        group = self.frame.group if isinstance(self.frame, HomogeneousSpace) else self.frame
        if not isinstance(group, MatrixGroup) or shape != group.point_shape:
            return ""
        name = "frame.coefficients" if group is self.frame else "frame.group.coefficients"
        return f"; {name}(matrix) are those of a matrix in the Lie algebra"

    def _solvers(self, kind: str) -> list[StageSolver] | None:
        """Return what finds the stages in turn: one at a time, or all at once; None if explicit."""
        if self.tableau.explicit:
            return None
        stages = range(len(self.rows))
        if self.tableau.rows is Rows.FULL:
            return [StageSolver(self, list(stages), kind)]
        return [StageSolver(self, [i], kind) for i in stages]


def _nonzero(row: Array) -> Row:
    return tuple((j, value) for j, value in enumerate(row.tolist()) if value != 0.0)
