"""What is integrated: the arguments after checking, and what takes the steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

from numpy.typing import ArrayLike

from cg.frames.arrays import Points
from cg.frames.base import Frame
from cg.integration.arguments import (
    MOST_COMPILED_STEPS,
    check_algebra,
    check_args,
    check_memory,
    check_points,
    check_problem,
)
from cg.integration.blocks import is_compiled
from cg.integration.compiled_rhs import CompiledRhs, compiled_rhs
from cg.integration.compiled_stepper import CompiledStepper
from cg.integration.implicit import check_stage_solver
from cg.integration.python_rhs import Coefficients, PythonRhs
from cg.integration.python_stepper import PythonStepper
from cg.integration.step import Step
from cg.integration.stepper import AdaptiveSchedule, Stepper
from cg.integration.time_grid import TimeGrid, stored_count
from cg.method import Method
from cg.munthe_kaas import MuntheKaas

__all__ = ["Problem", "make_problem"]


@dataclass(frozen=True)
class Problem:
    """What is integrated, and with what.

    Attributes
    ----------
    rhs
        The right-hand side; a compiled one may also be called from Python.
    frame
        The frame.
    method
        The method.
    points
        Initial points, shape ``(*batch, *point_shape)``.
    args
        Further arguments of events.
    stage_solver
        How implicit stages are found.
    """

    rhs: CompiledRhs | PythonRhs
    frame: Frame
    method: Method
    points: Points
    args: tuple[Any, ...]
    stage_solver: str

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading axes of the points."""
        return self.points.shape[: self.points.ndim - len(self.frame.point_shape)]

    @property
    def in_compiled_code(self) -> bool:
        """Whether steps are taken there."""
        return self.method.explicit and is_compiled(self.frame)

    @property
    def has_own_steps(self) -> bool:
        """Whether each member of an ensemble has steps of its own where they are chosen."""
        in_c = isinstance(self.rhs, CompiledRhs) and self.in_compiled_code
        return in_c and bool(self.batch)

    def member(self, index: tuple[int, ...]) -> Problem:
        """Return the problem of one member of an ensemble for a compiled function."""
        rhs = cast(CompiledRhs, self.rhs)
        if rhs.parameters is not None:
            rhs = rhs.on(self.frame, (), rhs.parameters[index])
        return Problem(
            rhs, self.frame, self.method, self.points[index], self.args, self.stage_solver
        )

    def stepper(
        self,
        schedule: TimeGrid | AdaptiveSchedule,
        *,
        slopes: bool = False,
        every: int = 1,
        workers: int = 1,
        watched: bool = False,
        keep: bool = False,
    ) -> Stepper:
        """Return what takes the steps; see `CompiledStepper`."""
        if self.in_compiled_code:
            return CompiledStepper(
                self.rhs, self.frame, self.method, self.batch, self.points, schedule,
                slopes=slopes, every=every, workers=workers, watched=watched, keep=keep,
            )  # fmt: skip
        rhs = self.rhs
        if isinstance(rhs, CompiledRhs):
            rhs = PythonRhs(cast(Coefficients, rhs), self.frame, self.batch)
        step = Step(rhs, self.frame, self.method, batch=self.batch, stage_solver=self.stage_solver)
        return PythonStepper(step, self.points, schedule, slopes=slopes, every=every)

    def check_grid(self, grid: TimeGrid, h: object, *, every: int = 1, between: bool) -> None:
        """Raise ValueError if a grid has more steps than can be counted or kept.

        Parameters
        ----------
        grid
            The steps.
        h
            What was given for their size.
        every
            How many steps there are between those that are kept; zero if none are.
        between
            Whether slopes are kept as well.
        """
        if self.in_compiled_code and grid.steps > MOST_COMPILED_STEPS:
            raise ValueError(
                f"h must leave at most {MOST_COMPILED_STEPS} steps, which is what compiled code "
                f"can count, got {h!r}"
            )
        size = self.points.nbytes + (8 * self.frame.dim * math.prod(self.batch) if between else 0)
        kept = stored_count(grid.steps, every) if every else 0
        check_memory(h, grid.steps, kept * (size + 8))


def make_problem(
    f: Any,
    frame: Frame,
    method: str | Method,
    y0: ArrayLike,
    *,
    args: Any = None,
    parameters: Any = None,
    stage_solver: str,
) -> Problem:
    """Check what every integration is given; see `cg.solve_ivp` for the arguments and errors."""
    check_stage_solver(stage_solver)
    compiled = compiled_rhs(f)
    tableau = check_problem(f if compiled is None else compiled, frame, method)
    if isinstance(tableau, MuntheKaas):
        check_algebra(frame, tableau)
    points = check_points(frame, y0)
    batch = points.shape[: points.ndim - len(frame.point_shape)]
    extra = check_args(args)
    rhs: CompiledRhs | PythonRhs
    if compiled is None:
        if parameters is not None:
            raise ValueError("parameters must be None unless f is compiled; args are for others")
        rhs = PythonRhs(cast(Callable[..., ArrayLike], f), frame, batch, extra)
    else:
        if extra:
            raise ValueError(f"args must be None for a compiled f, got {args!r}")
        rhs = compiled.on(frame, batch, parameters)
    return Problem(rhs, frame, tableau, points, extra, stage_solver)
