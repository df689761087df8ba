"""Integration of built-in problems in compiled code, in double or quadruple precision."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cg.catalogue import resolve_method
from cg.frames.arrays import Array
from cg.integration.loop.step_budget import StepBudget
from cg.integration.step.blocks import block_constants, describe_blocks
from cg.integration.step.paths import paths_of
from cg.method.method import Method
from cg.problems.affine import AffineField
from cg.problems.heavy_top import HeavyTop
from cg.support import quads
from cg.support.checks import check_integer, total_memory
from cg.support.parsing import read_fraction
from cg.support.shared_numbers import Stop

Kind = Literal["real64", "real128"]

# Rounds exact numbers to the arrays of a kind.
_Convert = Callable[..., Any]


@dataclass(frozen=True, eq=False)
class CompiledTrajectory:
    """A solution computed in compiled code, in the kind real64 or real128; arrays are read-only.

    ``t`` and ``y`` are times, shape ``(steps + 1,)``, and points, shape ``(steps + 1,
    *point_shape)``, rounded to float64. ``raw`` are the points in the kind of the computation:
    ``y`` itself, or the bytes of binary128 numbers as `cg.support.quads` has them, with a further
    axis of length 16.
    """

    t: Array
    y: Array
    raw: NDArray[Any]
    kind: Kind

    def __repr__(self) -> str:
        return f"CompiledTrajectory(t=0...{self.t[-1]:g}, steps={len(self.t) - 1}, {self.kind})"

    def exact(self, k: int) -> tuple[Fraction, ...]:
        """Return the exact values of the entries of point ``k``; negative counts from the end."""
        if self.kind == "real64":
            return tuple(map(Fraction, self.raw[k].ravel().tolist()))
        return tuple(quads.decode(self.raw[k].reshape(-1, 16)))


def integrate_compiled(
    problem: HeavyTop | AffineField,
    *,
    method: str | Method,
    h: Fraction | float | str,
    steps: int,
    kind: Kind = "real64",
) -> CompiledTrajectory:
    """Integrate a problem from time zero, with a given number of equal steps.

    All constants, including the exact coefficients of the method, are rounded once to the kind: 53
    or 113 binary digits. A float ``h`` means its exact binary value, a string a decimal or a
    quotient. The call releases the global interpreter lock; between calls of compiled code Python
    handles interrupts.

    TypeError if ``problem`` or ``method`` has another type; ValueError if the frame is not
    compiled, ``method`` is unknown or implicit, or another argument has an impossible value;
    OverflowError if the solution exceeds the range of floating point; MissingQuadsError for
    ``"real128"`` in a build without it.
    """
    if not isinstance(problem, HeavyTop | AffineField):
        raise TypeError(f"problem must be a HeavyTop or an AffineField, got {problem!r}")
    blocks = describe_blocks(problem.frame)
    tableau, size = resolve_method(method), _step_size(h)
    if not tableau.explicit:
        raise ValueError(f"method must be explicit, got {method!r}")
    steps = check_integer("steps", steps, 1)
    if kind not in ("real64", "real128"):
        raise ValueError(f'kind must be "real64" or "real128", got {kind!r}')

    core, convert = _core_of(kind)
    take_steps, start = _compiled_problem(problem, blocks, core, convert)
    _check_memory(steps, start.shape[-1], kind)
    paths = paths_of(tableau)
    constants_of_method = convert(paths.weights), convert(paths.c), convert([size])
    columns = np.zeros((*start.shape, steps + 1), dtype=start.dtype, order="F")
    columns[..., 0] = start
    budget = StepBudget()
    done = status = 0
    failed_at: Any = [0.0]
    while done < steps and status in (Stop.FINISHED, Stop.PAUSED):
        count = min(budget.start(), steps - done)
        status, failed_at = take_steps(paths.integers, *constants_of_method, done, count, columns)
        budget.stop(count)
        done += count
    if kind == "real64":
        raw: NDArray[Any] = np.ascontiguousarray(columns.T)
        points = raw
        t = float(failed_at[0])
    else:
        raw = np.ascontiguousarray(np.transpose(columns, (2, 1, 0)))
        points = quads.to_float(raw)
        t = float(quads.to_float(np.ascontiguousarray(failed_at.T))[0])
    if status != Stop.FINISHED:
        raise OverflowError(f"the solution is no longer finite at t = {t:.17g}")
    times = np.array([float(k * size) for k in range(steps + 1)])
    shape = (steps + 1, *problem.frame.point_shape)
    raw, points = raw.reshape(*shape, *raw.shape[2:]), points.reshape(shape)
    for array in (times, points, raw):
        array.flags.writeable = False
    return CompiledTrajectory(times, points, raw, kind)


def _compiled_problem(
    problem: HeavyTop | AffineField, blocks: Any, core: Any, convert: _Convert
) -> tuple[Callable[..., Any], Any]:
    """Return the compiled function that takes steps of a problem, and the initial point."""
    if isinstance(problem, HeavyTop):
        constants = convert(problem.inertia), convert([problem.mgl])
        return partial(core.heavy_top, *constants), convert(problem.y0_exact)
    of_frame = convert(_fractions(block_constants(problem.frame)))
    constant, slope = (convert(_fractions(x)) for x in (problem.constant, problem.slope))
    linear = convert(_fractions(problem.linear), problem.linear.shape)
    take_steps = partial(core.affine_field, blocks, of_frame, constant, linear, slope)
    return take_steps, convert(_fractions(problem.y0))


def _step_size(h: Fraction | float | str) -> Fraction:
    try:
        if isinstance(h, bool | np.bool_):
            raise TypeError
        size = read_fraction(h)
        float(size)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError) as error:
        raise ValueError(f"h must be a finite number, got {h!r}") from error
    if size <= 0:
        raise ValueError(f"h must be positive, got {h!r}")
    return size


def _core_of(kind: Kind) -> tuple[Any, _Convert]:
    if kind == "real128":
        return quads.core('kind="real128"'), _quads
    from cg import _core_r64

    return _core_r64, _doubles


def _check_memory(steps: int, entries: int, kind: Kind) -> None:
    # rows for Fortran and for Python, the points in double precision, and the times
    needed = steps * (entries * (16 if kind == "real64" else 40) + 8)
    if needed > total_memory():
        raise ValueError(
            f"steps = {steps} need {needed / 2**30:.3g} GiB of memory, and there are "
            f"{total_memory() / 2**30:.3g} GiB"
        )


def _fractions(values: Array) -> list[Fraction]:
    return [Fraction(x) for x in values.ravel().tolist()]


def _doubles(values: Iterable[Fraction], shape: tuple[int, ...] = (-1,)) -> Array:
    return np.array([float(x) for x in values]).reshape(shape)


def _quads(values: Iterable[Fraction], shape: tuple[int, ...] = (-1,)) -> quads.Quads:
    """Return binary128 numbers with their bytes along the first axis, as Fortran has them."""
    return np.moveaxis(quads.encode(values).reshape(*shape, 16), -1, 0)
