"""The stage equations of implicit methods, by fixed-point or Newton iteration in the algebra."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from cg.conditions import Rows
from cg.frames.arrays import Array, Points
from cg.frames.base import FlowOverflowError, Frame
from cg.integration.rhs.python import StageOverflowError
from cg.integration.step.flows import flows_of
from cg.method.tableau import Tableau

Row = tuple[tuple[int, float], ...]
"""Pairs of a stage (from 0) and a coefficient that isn't zero."""

STAGE_SOLVERS = {"newton": 25, "fixed-point": 100}
"""The iterations for implicit stages, and their largest numbers of iterations."""

# Newton's method takes fewer evaluations on the free rigid body at all step sizes: 9 instead of 11
# in a step where fixed-point corrections decrease by a factor of 20, 13 instead of 18 where by 5.
DEFAULT_STAGE_SOLVER = "newton"

_EPSILON = float(np.finfo(np.float64).eps)
# corrections below this that no longer decrease are rounding errors of f
_NOISE = 1e-10
# a stored Jacobian is replaced if a correction decreases by less than this factor
_SLOW = 0.1
# the iteration has diverged if residuals grow by this factor
_DIVERGED = 1e3


class ConvergenceError(RuntimeError):
    """The stage equations of an implicit method were not solved.

    Attributes
    ----------
    iterations
        Iterations that were made.
    residual
        Largest residual of the stage equations, in the units of ``f``; NaN if it isn't known.
    t
        Time at which the step starts.
    h
        Signed step size.

    Examples
    --------
    A step so long that its stage equations have no solution:

    >>> import cg
    >>> try:
    ...     cg.integrate(
    ...         lambda t, y: 1.0 + y**2, (0, 4), [0.0], frame=cg.frames.Euclidean(1),
    ...         method="ImplicitMidpoint", h=4.0,
    ...     )
    ... except cg.ConvergenceError as error:
    ...     print(f"the step from t = {error.t:g} with h = {error.h:g}")
    the step from t = 0 with h = 4
    """

    def __init__(self, reason: str, iterations: int, residual: float, t: float, h: float) -> None:
        remainder = "" if math.isnan(residual) else f" the residual is {residual:.3g}"
        super().__init__(
            f"the implicit stages did not converge ({reason}): after {iterations} iterations"
            f"{remainder} in the step of h = {h:.6g} from t = {t:.17g}; "
            "a smaller step or another stage_solver may help"
        )
        self.iterations = iterations
        self.residual = residual
        self.t = t
        self.h = h


def check_stage_solver(kind: object) -> None:
    """Raise ValueError unless ``kind`` is one of `STAGE_SOLVERS`."""
    if not isinstance(kind, str) or kind not in STAGE_SOLVERS:
        names = " or ".join(f'"{name}"' for name in STAGE_SOLVERS)
        raise ValueError(f"stage_solver must be {names}, got {kind!r}")


class ImplicitStages:
    """The coefficients at the stages of an implicit method, for steps of any number of members.

    Parameters
    ----------
    rhs
        ``rhs(member, t, y)`` returns the coefficients.
    frame, method
        The frame and the method.
    kind
        One of `STAGE_SOLVERS`.
    lanes
        How many members are integrated at the same time.
    """

    def __init__(
        self,
        rhs: Callable[[int, float, Points], Array],
        frame: Frame,
        method: Tableau,
        kind: str,
        lanes: int = 1,
    ) -> None:
        self.rhs = rhs
        self.frame = frame
        self.rows = [_nonzero(row) for row in method.a]
        self.abscissae: list[float] = method.c.tolist()
        self._flows = flows_of(frame)
        stages = list(range(method.stages))
        self._blocks = [stages] if method.rows is Rows.FULL else [[i] for i in stages]
        self._kind = kind
        self._lanes = lanes
        self._member = -1
        self._solvers: dict[int, list[StageSolver]] = {}  # of members, the latest one last
        self._start: tuple[float, Array] = 0.0, np.empty(0)
        self.nfev = self.nexp = self.njev = self.nlu = 0

    def __call__(
        self, t: float, point: Points, h: float, slope: Array, member: int
    ) -> tuple[Array, list[int]]:
        """Return the coefficients, shape ``(stages, dim)``, and four counts.

        Parameters
        ----------
        t, point, h
            Start and signed size of the step.
        slope
            The coefficients at the start.
        member
            Index of the member; its Jacobian is kept for its next step.

        Raises
        ------
        ConvergenceError
            If the iteration doesn't reach the level of rounding.
        """
        self._member = member
        solvers = self._solvers.pop(member, None)
        if solvers is None:
            solvers = [StageSolver(self, block, self._kind) for block in self._blocks]
            if len(self._solvers) == self._lanes:
                del self._solvers[next(iter(self._solvers))]
        self._solvers[member] = solvers
        self.nfev = self.nexp = self.njev = self.nlu = 0
        self._start = t, slope
        fields = np.tile(slope, (len(self.abscissae), 1))
        for solver in solvers:
            solver(t, point, h, fields)
        return fields, self.taken()

    def taken(self) -> list[int]:
        """Return the evaluations, flows, Jacobians and factorisations of the last call."""
        return [self.nfev, self.nexp, self.njev, self.nlu]

    def state(self) -> Any:
        """Return the state kept between steps."""
        return {
            member: [solver.inverse for solver in solvers]
            for member, solvers in self._solvers.items()
        }

    def restore(self, state: Any) -> None:
        """Restore the state kept between steps."""
        for member, inverses in state.items():
            self._solvers[member] = [StageSolver(self, block, self._kind) for block in self._blocks]
            for solver, inverse in zip(self._solvers[member], inverses, strict=True):
                solver.inverse = inverse

    def field(self) -> Array:
        """Return the coefficients at the start of the step, which are known."""
        return self._start[1]

    def evaluate(self, t: float, point: Points) -> Array:
        """Return the coefficients at a point."""
        self.nfev += 1
        return self.rhs(self._member, t, point)

    def compose(self, row: Row, fields: Array, point: Points, h: float) -> Points:
        """Apply the flows of a row of coefficients, that of the lowest stage first."""
        self.nexp += len(row)
        if not row:
            return point
        weights = np.array([h * weight for _, weight in row])
        v = weights[:, None] * fields[[j for j, _ in row], :]
        try:
            return self._flows(v, point, True)
        except FlowOverflowError as error:
            raise StageOverflowError(str(error)) from error


def _nonzero(row: Array) -> Row:
    return tuple((j, value) for j, value in enumerate(row.tolist()) if value != 0.0)


class StageSolver:
    r"""Solve the equations of some stages, those before them being known.

    The unknowns are the stage coefficients, not the stages, so that they live in a linear space
    whatever the manifold is:

    .. math::

        k_i = f(t + c_i h, Y_i(k)), \qquad Y_i(k) = e^{h a_{is} k_s} \cdots e^{h a_{i1} k_1} p .

    ``"fixed-point"`` iterates this equation.  ``"newton"`` takes the Jacobian of
    :math:`k - f(Y(k))` by differences along the flows, as in [1]_ but with the derivative of the
    exponential inside the difference, and keeps its inverse, also over several steps, as long as
    corrections decrease by a factor of ten.  Both iterate down to the level of rounding, since an
    implicit method preserves invariants only as accurately as its stages are solved.

    Parameters
    ----------
    step
        The step whose stages they are.
    block
        Indices of the stages, consecutive.
    kind
        One of `STAGE_SOLVERS`.

    References
    ----------
    .. [1] B. Owren, B. Welfert, "The Newton iteration on Lie groups", BIT 40 (2000), 121-145.
    """

    def __init__(self, step: ImplicitStages, block: list[int], kind: str) -> None:
        self.step = step
        self.block = block
        self.kind = kind
        known = range(block[0])
        self.before = [tuple(x for x in step.rows[i] if x[0] in known) for i in block]
        self.within = [tuple(x for x in step.rows[i] if x[0] not in known) for i in block]
        self.inverse: tuple[float, Array] | None = None

    def __call__(self, t: float, point: Points, h: float, fields: Array) -> None:
        """Solve for the coefficients of the stages and store them in ``fields``.

        Parameters
        ----------
        t, point, h
            Start and signed size of the step.
        fields
            Coefficients of all stages, shape ``(stages, dim)``; those of this block are
            the initial guess.

        Raises
        ------
        ConvergenceError
            If the iteration doesn't reach the level of rounding.
        """
        step = self.step
        bases = [step.compose(row, fields, point, h) for row in self.before]
        times = [t + step.abscissae[i] * h for i in self.block]
        if not any(self.within):
            at_start = not self.before[0] and times[0] == t
            value = step.field() if at_start else step.evaluate(times[0], bases[0])
            fields[..., self.block[0], :] = value
            return

        def evaluated(unknowns: Array) -> Array:
            trial = fields.copy()
            trial[..., self.block, :] = unknowns
            return np.stack(
                [
                    step.evaluate(time, step.compose(row, trial, base, h))
                    for time, row, base in zip(times, self.within, bases, strict=True)
                ],
                axis=-2,
            )

        fields[..., self.block, :] = self._iterate(
            evaluated, fields[..., self.block, :], t, point, h
        )

    def _iterate(
        self, evaluated: Callable[[Array], Array], k: Array, t: float, point: Points, h: float
    ) -> Array:
        """Return the solution of ``evaluated(k) == k``, from the guess ``k``."""
        # a change of k by this moves a stage by about the size of its coordinates
        movement = self.step.frame.coordinate_sizes(point)[..., None, :] / abs(h)
        newton = self.kind == "newton"
        most = STAGE_SOLVERS[self.kind]
        previous = smallest = residual = np.inf
        for iteration in range(1, most + 1):
            try:
                value = evaluated(k)
                correction = value - k
                residual = float(np.abs(correction).max())
                if newton:
                    if self.inverse is None or self.inverse[0] != h:
                        scale = np.maximum(np.abs(k), movement)
                        self.inverse = h, self._inverse(evaluated, k, value, scale)
                    correction = _apply(self.inverse[1], correction)
            except (StageOverflowError, np.linalg.LinAlgError) as error:
                self.inverse = None
                raise ConvergenceError(str(error), iteration, residual, t, h) from error
            k = k + correction
            scale = np.maximum(np.abs(k), movement)
            size = float((np.abs(correction) / np.where(scale > 0.0, scale, 1.0)).max())
            if size <= _EPSILON or previous <= size <= _NOISE:
                return k
            if not residual <= _DIVERGED * smallest:
                self.inverse = None
                raise ConvergenceError("it diverges", iteration, residual, t, h)
            if newton and size > max(_SLOW * previous, _NOISE):
                self.inverse = None
            previous, smallest = size, min(smallest, residual)
        self.inverse = None
        raise ConvergenceError("it is too slow", most, residual, t, h)

    def _inverse(
        self, evaluated: Callable[[Array], Array], k: Array, value: Array, scale: Array
    ) -> Array:
        """Return the inverse of the Jacobian of ``k - evaluated(k)``, shape ``(*batch, n, n)``."""
        stages, dim = k.shape[-2:]
        size = np.sqrt(_EPSILON) * np.where(scale > 0.0, scale, 1.0)
        jacobian = np.empty((*k.shape[:-2], stages * dim, stages * dim))
        for column, (i, j) in enumerate(np.ndindex(stages, dim)):
            moved = k.copy()
            moved[..., i, j] += size[..., i, j]
            difference = (evaluated(moved) - value) / (moved - k)[..., i, j, None, None]
            jacobian[..., column] = -difference.reshape(*k.shape[:-2], -1)
        jacobian += np.eye(stages * dim)
        self.step.njev += 1
        self.step.nlu += 1
        return np.linalg.inv(jacobian)


def _apply(inverse: Array, correction: Array) -> Array:
    flat = correction.reshape(*inverse.shape[:-1], 1)
    return np.asarray((inverse @ flat).reshape(correction.shape))
