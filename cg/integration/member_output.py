"""Members of an ensemble with steps of their own, and output on their way.

Compiled code takes the steps, one member after the other; then the solution within the steps that
have output in them is made for many members at a time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from cg.frames.arrays import Array, Points
from cg.integration.compiled_rhs import CompiledRhs
from cg.integration.compiled_run import CompiledRun
from cg.integration.dense import DenseOutput
from cg.integration.interpolant import Indices, Interpolant, result_flows
from cg.integration.interpolation import (
    Steps,
    extra_evaluations,
    flows_within,
    interpolant_of,
)
from cg.integration.problem import Problem
from cg.integration.progress import Progress
from cg.integration.python_rhs import StepTooLongError
from cg.integration.recorder import steps_of
from cg.integration.step_budget import StepBudget
from cg.integration.stepper import AdaptiveSchedule, Block, Counts
from cg.shared_numbers import Stop

__all__ = ["MemberOutput"]

_MEMBERS = 1024  # whose state compiled code holds at a time
_STEPS = 1024  # of one member at a time
_WITH_OUTPUT = 4096  # steps, of however many members, at a time


class _FailedError(Exception):
    """A member can't go on, or its function failed between the steps."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """Steps of one member that have output in them.

    Attributes
    ----------
    member
        Its place.
    steps
        The steps.
    slots
        Which of the wanted times lie within them, shape ``(n,)``.
    which
        In which of the steps they do; same shape.
    """

    member: int
    steps: Steps
    slots: Indices
    which: Indices


@dataclass
class _Path:
    """What is known of one member.

    Attributes
    ----------
    counts
        What it took.
    ends
        The ends of its steps.
    parts
        Its continuous solution.
    failed
        Whether it has to be integrated by itself, which tells what is wrong.
    told
        Whether its end was reported as progress.
    """

    counts: Counts = field(default_factory=Counts)
    ends: list[Array] = field(default_factory=list)
    parts: list[Interpolant] = field(default_factory=list)
    failed: bool = False
    told: bool = False


class MemberOutput:
    """Integrates an ensemble for a compiled function; the steps are those of members alone.

    Parameters
    ----------
    problem
        The ensemble.
    schedule
        How steps are chosen.
    wanted
        Times at which to keep the solution.
    dense
        Whether to keep a continuous solution.
    watch
        Is told how far it has come.

    Attributes
    ----------
    y
        The points at the wanted times, shape ``(times, members, *point_shape)``, NaN for members
        that are left.
    counts
        What all members took that are not left.
    left
        The places of members whose steps or function failed.
    outputs
        Continuous solutions by the places of members, if they are wanted.
    """

    def __init__(
        self,
        problem: Problem,
        schedule: AdaptiveSchedule,
        wanted: Array,
        dense: bool,
        watch: Progress,
    ) -> None:
        self.problem = problem
        self.schedule = schedule
        self.wanted = wanted
        self.dense = dense
        self.watch = watch
        shape = problem.frame.point_shape
        self.points = np.ascontiguousarray(problem.points).reshape(-1, *shape)
        self.y = np.full((len(wanted), *self.points.shape), math.nan, dtype=self.points.dtype)
        self.counts = Counts()
        self.left: list[int] = []
        self.outputs: dict[int, DenseOutput] = {}
        self._rows = self.points.reshape(len(self.points), -1).view(np.float64)
        self._at_start = int((wanted == schedule.start).sum())
        self._budget = StepBudget()
        self._pieces: list[_Piece] = []
        self._collected = 0  # steps of all pieces
        self._t = np.empty(_STEPS + 1)
        self._buffer = np.empty((_STEPS + 1, 1, self._rows.shape[1]))
        self._slopes = np.empty((_STEPS, 1, problem.frame.dim))

    def integrate(self) -> None:
        """Integrate all members."""
        for first in range(0, len(self.points), _MEMBERS):
            rows = self._rows[first : first + _MEMBERS]
            rhs = cast(CompiledRhs, self.problem.rhs)
            run = CompiledRun(
                rhs, self.problem.frame, self.problem.method, rows, self.schedule, first=first
            )
            paths = [_Path() for _ in rows]
            for i, path in enumerate(paths):
                try:
                    self._take_steps(run, i, path, first)
                except _FailedError:
                    path.failed = True
                    self._pieces = [piece for piece in self._pieces if piece.member != i]
                    self._collected = sum(len(piece.steps) for piece in self._pieces)
                else:
                    path.told = True
                    self.watch.finish_members()
                if self._collected >= _WITH_OUTPUT:
                    self._fill(run, paths, first)
            if self._pieces:
                self._fill(run, paths, first)
            self._keep(paths, first)

    def _take_steps(self, run: CompiledRun, i: int, path: _Path, first: int) -> None:
        """Take all steps of a member."""
        used, left = self._at_start, self.schedule.max_steps
        self.y[:used, first + i] = self.points[first + i]
        self._t[0], self._buffer[0] = self.schedule.start, self._rows[first + i]
        path.ends.append(self._t[:1].copy())
        status = Stop.PAUSED
        while status is Stop.PAUSED and left > 0:
            steps = min(self._budget.start(), _STEPS, left)
            taken, statuses, _, _ = run.advance(
                slice(i, i + 1), steps, 1, self._t[1:], self._buffer[1:], self._slopes, column=0
            )
            attempts, accepted, stored, nfev, nexp = taken[:, 0].tolist()
            self._budget.stop(attempts)
            left -= attempts
            path.counts.add(
                Counts(nfev=nfev, nexp=nexp, steps=accepted, rejected=attempts - accepted)
            )
            status = Stop(statuses[0])
            if stored:
                used += self._collect(run, i, path, first, stored, used)
                self._t[0], self._buffer[0] = self._t[stored], self._buffer[stored]
                self.watch.reach(float(self._t[0]))
        if status is not Stop.FINISHED:
            raise _FailedError

    def _collect(
        self, run: CompiledRun, i: int, path: _Path, first: int, stored: int, used: int
    ) -> int:
        """Keep what is wanted of some steps; return how many wanted times they reach."""
        points = self._buffer[: stored + 1].view(self.points.dtype)
        block = Block(
            self._t[: stored + 1],
            points.reshape(stored + 1, *self.problem.frame.point_shape),
            self._slopes[:stored, 0],
        )
        which, inside = steps_of(self.wanted[used:], block.t, float(block.t[-1]))
        slots = used + np.arange(len(which))
        self.y[slots, first + i] = block.y[which + 1]
        needed = np.arange(stored) if self.dense else np.unique(which[inside])
        if self.dense:
            path.ends.append(block.t[1:].copy())
        if needed.size:

            def last_slope() -> Array:
                slope, evaluations, status, _ = run.slope(i)
                if status != Stop.FINISHED:
                    raise _FailedError
                path.counts.nfev += evaluations
                return slope

            steps = Steps.of(block, needed, last_slope)
            place = np.searchsorted(needed, which[inside])
            self._pieces.append(_Piece(i, steps, slots[inside], place))
            self._collected += len(steps)
            method = self.problem.method
            path.counts.nfev += len(steps) * extra_evaluations(method)
            path.counts.nexp += len(steps) * flows_within(method)
            path.counts.nexp += len(place) * (len(result_flows(method)) + 1)
        return len(which)

    def _fill(self, run: CompiledRun, paths: list[_Path], first: int) -> None:
        """Make the solution within the collected steps."""
        pieces = self._pieces
        sizes = [len(piece.steps) for piece in pieces]
        self._pieces, self._collected = [], 0
        owner = np.repeat([piece.member for piece in pieces], sizes)
        steps = Steps.join([piece.steps for piece in pieces])

        def evaluate(which: Indices, t: Array, y: Points) -> Array:
            return self._evaluate(run, paths, owner[which], t, y)

        try:
            made = interpolant_of(self.problem.frame, self.problem.method, steps, evaluate)
            begins = np.cumsum([0, *sizes])
            slots = np.concatenate([piece.slots for piece in pieces])
            which = [piece.which + begin for piece, begin in zip(pieces, begins[:-1], strict=True)]
            found = made.at(np.concatenate(which), self.wanted[slots])
        except StepTooLongError:
            for piece in pieces:
                paths[piece.member].failed = True
            return
        members = np.repeat([piece.member for piece in pieces], [len(p.slots) for p in pieces])
        self.y[slots, first + members] = found
        if self.dense:
            for piece, (begin, end) in zip(pieces, pairwise(begins.tolist()), strict=True):
                paths[piece.member].parts.append(made.part(np.arange(begin, end)))

    def _evaluate(
        self,
        run: CompiledRun,
        paths: list[_Path],
        owners: NDArray[np.intp],
        t: Array,
        y: Points,
    ) -> Array:
        """Return coefficients of members at times and points, NaN where a point isn't finite."""
        rows = np.ascontiguousarray(y).reshape(len(t), -1).view(np.float64)
        values = np.full((len(t), self.problem.frame.dim), math.nan)
        begins = np.concatenate([[0], np.flatnonzero(np.diff(owners)) + 1])
        finite = np.logical_and.reduceat(np.isfinite(rows).all(axis=1), begins)
        bounds = pairwise([*begins.tolist(), len(t)])
        for (begin, end), good in zip(bounds, finite.tolist(), strict=True):
            member = int(owners[begin])
            if not good:
                continue
            done, status, _ = run.evaluate(member, t[begin:end], rows[begin:end], values[begin:end])
            if status != Stop.FINISHED:
                values[begin + done : end] = math.nan
                paths[member].failed = True
        return values

    def _keep(self, paths: list[_Path], first: int) -> None:
        """Keep what was found of those that haven't failed."""
        for i, path in enumerate(paths, first):
            if path.failed:
                self.left.append(i)
                self.y[:, i] = math.nan
                self.watch.finish_members(-path.told)
                continue
            self.counts.add(path.counts)
            if self.dense:
                joined = Interpolant.join(path.parts)
                self.outputs[i] = DenseOutput(np.concatenate(path.ends), joined, self.points[i])
