"""The state of a stepper, for copies and pickles."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np


def get_state(stepper: Any) -> dict[str, Any]:
    """Return the state of a stepper, which can be pickled."""
    run = stepper._run
    jacobian = run.callbacks.jacobian
    state = {
        name: value
        for name, value in vars(stepper).items()
        if name not in ("_problem", "_run", "_core", "_stops_are_set", "_target")
    }
    reals, integers, points, slopes = run.state()
    current = run.plan.points(np.ascontiguousarray(points[:, 0]), (len(points),))
    state["problem"] = replace(stepper._problem, points=current, t0=stepper.t)
    state["trajectories"] = reals, integers, points, slopes
    state["counts"] = run.counts.copy(), run.status.copy(), run.flag.copy()
    kept = {} if jacobian is None else jacobian.kept
    state["matrices"] = {member: matrix for member, (matrix, *_) in kept.items()}
    return state


def set_state(stepper: Any, state: dict[str, Any]) -> None:
    """Give a new stepper a state from `get_state`."""
    state = dict(state)
    problem = copy.copy(state.pop("problem"))  # with a right-hand side of its own
    reals, integers, points, slopes = state.pop("trajectories")
    counts, status, flag = state.pop("counts")
    matrices = state.pop("matrices")
    vars(stepper).update(state)
    stepper._problem = problem
    stepper._run = run = stepper._make_run()
    if run.callbacks.jacobian is not None:
        run.callbacks.jacobian.kept.update((k, [matrix]) for k, matrix in matrices.items())
    stepper._core.loop_state(
        run.address, True, reals.T, integers.T, points.transpose(2, 1, 0), slopes.transpose(2, 1, 0)
    )
    run.counts[...], run.status[...], run.flag[...] = counts, status, flag
    run.reached[...] = stepper.t
    stepper._stops_are_set = False
