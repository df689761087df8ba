"""The state of a stepper: copies, pickles, and what a restart replaces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.integration.arguments import check_args
from cg.integration.friction import check_members
from cg.integration.rhs.inputs import check_inputs
from cg.integration.rhs.python import PythonRhs
from cg.support.arrays import Array, Points, check_finite, real_array


def get_state(stepper: Any) -> dict[str, Any]:
    """Return the state of a stepper, which can be pickled."""
    run = stepper._run
    jacobian = run.callbacks.jacobian
    state = {
        name: value
        for name, value in vars(stepper).items()
        if name not in ("_problem", "_run", "_core", "_stops_are_set", "_target")
    }
    state["_found"] = list(stepper._found)
    reals, integers, points, slopes = run.state()
    current = run.plan.points(np.ascontiguousarray(points[:, 0]), (len(points),))
    rhs = run.rhs  # with memory of its own for inputs, as copies may run in two threads
    rhs = rhs.with_data(rhs.args, rhs.parameters, rhs.inputs, rhs.first)
    state["problem"] = replace(stepper._problem, rhs=rhs, points=current, t0=stepper.t)
    state["trajectories"] = reals, integers, points, slopes
    state["counts"] = run.counts.copy(), run.status.copy(), run.flag.copy()
    kept = {} if jacobian is None else jacobian.kept
    state["matrices"] = {member: matrix for member, (matrix, *_) in kept.items()}
    return state


def restored(kind: type, state: dict[str, Any]) -> Any:
    """Return a stepper with a state from `get_state`."""
    stepper: Any = object.__new__(kind)
    state = dict(state)
    stepper._problem = state.pop("problem")
    reals, integers, points, slopes = state.pop("trajectories")
    counts, status, flag = state.pop("counts")
    matrices = state.pop("matrices")
    vars(stepper).update(state)
    stepper._make_run()
    run = stepper._run
    if run.callbacks.jacobian is not None:
        run.callbacks.jacobian.kept.update((k, [matrix]) for k, matrix in matrices.items())
    stepper._core.loop_state(
        run.address, True, reals.T, integers.T, points.transpose(2, 1, 0), slopes.transpose(2, 1, 0)
    )
    run.counts[...], run.status[...], run.flag[...] = counts, status, flag
    run.reached[...] = stepper.t
    stepper._stops_are_set = False
    return stepper


def check_new_y(stepper: Any, y: ArrayLike) -> Points:
    """Return new points of a stepper, one row for each member, after checking them."""
    frame, many = stepper.frame, stepper._many
    points: Points = frame.read_points(y, "y")
    shape = (stepper._run.members, *frame.point_shape) if many else frame.point_shape
    if points.shape != shape:
        raise ValueError(f"y must have shape {shape}, got {points.shape}")
    rows = points if many else points[None]
    for row in rows:
        frame.check_point(row, name="y")
    return rows


def replace_rhs(
    stepper: Any,
    t: float,
    rows: Array,
    args: Iterable[Any] | None,
    parameters: ArrayLike | None,
    inputs: Any,
) -> None:
    """Replace what ``f`` gets besides time and point from time t on, None for what remains.

    ``rows`` are the points there, as doubles.
    """
    run, rhs = stepper._run, stepper._run.rhs
    extra = rhs.args if args is None else check_args(args)
    numbers = rhs.parameters
    if parameters is not None:
        numbers = _read_parameters(parameters, numbers, stepper._many)
    curves = rhs.inputs
    if inputs is not None:
        if curves is None:
            raise ValueError(f"inputs must be None, since the constructor got none, got {inputs!r}")
        members = run.members if stepper._many else None
        curves = check_inputs(inputs, t, t, members, None)
        assert curves is not None
        curves.check_like(rhs.inputs)
    if extra is not rhs.args or numbers is not rhs.parameters or curves is not rhs.inputs:
        changed = rhs.with_data(extra, numbers, curves, rhs.first)
        check_data(changed, stepper._many, rhs)
        check_members(run.plan, changed, t, run.plan.points(rows, (run.members,)))
        run.replace_rhs(changed)
        if inputs is not None:
            stepper._set_limits(curves)


def check_data(rhs: Any, many: bool, before: Any = None) -> None:
    """Raise TypeError if ``f`` can't take as many args, ValueError if parameters aren't finite.

    What is as ``before`` isn't checked again.
    """
    numbers, args = rhs.parameters, rhs.args
    if numbers is not None and (before is None or numbers is not before.parameters):
        check_finite(numbers if many else numbers[0], "parameters")
    if not isinstance(rhs, PythonRhs) or (before is not None and len(args) == len(before.args)):
        return
    rhs.check_call()


def _read_parameters(parameters: ArrayLike, before: Array | None, many: bool) -> Array:
    """Return new parameters, a row for each member, after checking their shape."""
    numbers = real_array(parameters, "parameters")
    if before is None:
        raise ValueError(
            f"parameters must be None, since the constructor got none, got {parameters!r}"
        )
    shape = before.shape if many else before.shape[1:]
    if numbers.shape != shape:
        raise ValueError(f"parameters must have shape {shape}, got {numbers.shape}")
    numbers.flags.writeable = False
    return numbers if many else numbers[None]
