"""The state of a stepper, for copies and pickles."""

from __future__ import annotations

from typing import Any

import numpy as np

from cg.integration.problem import make_rhs
from cg.integration.step.plan import plan_of

__all__ = ["get_state", "set_state"]


def get_state(stepper: Any) -> dict[str, Any]:
    """Return the state of a stepper, which can be pickled."""
    run = stepper._run
    members, dim = run.members, stepper.frame.dim
    reals, integers = np.empty((members, 9)), np.empty((members, 11), dtype=np.int64)
    points = np.empty((members, 2, run.plan.width))
    slopes = np.empty((members, 2 + run.kept, dim))
    stepper._core.loop_state(
        run.address, False, reals.T, integers.T, points.transpose(2, 1, 0),
        slopes.transpose(2, 1, 0),
    )  # fmt: skip
    stages, jacobian = run.callbacks.stages, run.callbacks.jacobian
    state = {
        name: value
        for name, value in vars(stepper).items()
        if name not in ("_run", "_rhs", "_core", "_stops_are_set", "_target")
    }
    state["parameters"] = stepper._rhs.parameters
    state["vectorized"] = stepper._rhs.vectorized
    state["trajectories"] = reals, integers, points, slopes
    state["counts"] = run.counts.copy(), run.status.copy(), run.flag.copy()
    state["stages"] = None if stages is None else stages.state()
    kept = {} if jacobian is None else jacobian.kept
    state["matrices"] = {member: matrix for member, (matrix, *_) in kept.items()}
    return state


def set_state(stepper: Any, state: dict[str, Any]) -> None:
    """Give a new stepper a state from `get_state`."""
    state = dict(state)
    numbers, vectorized = state.pop("parameters"), state.pop("vectorized")
    reals, integers, points, slopes = state.pop("trajectories")
    counts, status, flag = state.pop("counts")
    stages, matrices = state.pop("stages"), state.pop("matrices")
    vars(stepper).update(state)
    members = len(reals)
    stepper._rhs, _ = make_rhs(
        stepper.f, stepper.frame, stepper._args or None, numbers, vectorized, members
    )
    t = stepper.t
    plan = plan_of(stepper.frame, stepper.method)
    rows = np.ascontiguousarray(points[:, 0])
    stepper._run = run = stepper._make_run(t, plan.points(rows, (members,)))
    if run.callbacks.jacobian is not None:
        run.callbacks.jacobian.kept.update((k, [matrix]) for k, matrix in matrices.items())
    stepper._core.loop_state(
        run.address, True, reals.T, integers.T, points.transpose(2, 1, 0), slopes.transpose(2, 1, 0)
    )
    run.counts[...], run.status[...], run.flag[...] = counts, status, flag
    run.reached[...] = t
    if stages is not None and run.callbacks.stages is not None:
        run.callbacks.stages.restore(stages)
    stepper._stops_are_set = False
