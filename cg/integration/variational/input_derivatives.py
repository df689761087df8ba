r"""Derivatives of a solution with respect to the values of samples.

In the interval k between samples the solution depends on the present values :math:`u_k` alone. Its
transition matrix :math:`\Phi_k` and its derivative :math:`S_k` by them start anew at each sample,
and the derivative of the end by :math:`u_k` is :math:`\Phi_n \cdots \Phi_{k+1} S_k`. This takes
as many columns as there are inputs at one time, where parameters would take as many as there are
samples. A linear curve is :math:`(1 - s)\,u_k + s\,u_{k+1}` with s linear in time, so that
derivatives multiplied by the time are integrated as well (the moments of `VariationalField`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cg.frames.arrays import Array
from cg.integration.loop.drive import drive
from cg.integration.loop.failures import explain_failure
from cg.integration.loop.run import Run
from cg.integration.member_results import MemberResults, Results
from cg.integration.problem import Problem
from cg.integration.rhs.inputs import Inputs
from cg.integration.variational.problem import add_derivatives
from cg.integration.variational.results import VariationalSolution


def check_problem(problem: Problem) -> Inputs:
    """Return the inputs of a problem whose solution has derivatives with respect to them."""
    inputs = problem.rhs.inputs
    if inputs is None:
        raise ValueError("inputs must be given with input_derivatives, got None")
    for curve in inputs.curves:
        if curve.kind not in ("hold", "linear"):
            raise ValueError(
                'inputs must be of kind "hold" or "linear" with input_derivatives, got '
                f"{curve.kind!r}; gradients with derivatives='adjoint' take any kind"
            )
    for name, given in (
        ("events", problem.events), ("t_eval", problem.t_eval),
        ("dense_output", problem.dense or None),
    ):  # fmt: skip
        if given is not None:
            raise ValueError(f"{name} must not be given with input_derivatives")
    return inputs


def solve_with_input_derivatives(
    problem: Problem, jac: Any, df_dp: Any, P0: Any, control_derivatives: Any
) -> VariationalSolution:
    """Return the solution at all times of samples, with derivatives with respect to their values.

    Arguments are those of `add_derivatives`.
    """
    inputs = check_problem(problem)
    width = inputs.width
    moments = width if any(curve.kind == "linear" for curve in inputs.curves) else 0
    times = np.concatenate([problem.stops[:-1], *(curve.times for curve in inputs.curves)])
    sign, t0, t1 = (1.0 if problem.t1 >= problem.t0 else -1.0), problem.t0, problem.t1
    inside = np.unique(times[(sign * times > sign * t0) & (sign * times < sign * t1)])
    stops = np.append(inside[:: int(sign)], t1)
    joint = add_derivatives(problem, jac, df_dp, P0, control_derivatives, moments)
    field = joint.make_solution.variational  # type: ignore[union-attr]
    run = Run(replace(joint, stops=stops, every=0), keep_last=True, lanes=1)
    chain = _Chain(run, field, t0)
    messages = {}
    for stop in stops.tolist() if t0 != t1 else []:
        failure = chain.advance(stop)
        if isinstance(failure, Exception):
            raise failure
        if failure is not None:
            messages[0] = failure.removesuffix(".")
            break
    result = Results(joint, None)
    status = np.array([-1 if messages else 0])
    points = run.plan.points(np.array(chain.rows), (len(chain.rows), 1))
    result.add(slice(0, 1), MemberResults(
        np.array(chain.times), points, None, run.reached, status, run.counts, messages, None, None,
        [],
    ))  # fmt: skip
    solution: Any = result.solution()[0]
    own = field.count - field.inputs
    changed: VariationalSolution = replace(
        solution,
        sensitivity=solution.sensitivity[..., :own] if own else None,
        input_sensitivity=None if messages else chain.by_values(inputs, own),
    )
    return changed


class _Chain:
    """Integrations between samples, one after the other."""

    def __init__(self, run: Run, field: Any, t0: float) -> None:
        self.run, self.field = run, field
        self.times = [t0]
        self.rows = [run.end[0].copy()]
        self.parts: list[Array] = []  # derivatives over each interval
        first = run.control.first_step or 0.0
        run._core.loop_restart(run.address, t0, run.end.T, first, run.rhs.data_address)

    def advance(self, stop: float) -> Exception | str | None:
        """Integrate up to a sample; return why that failed."""
        run, record, start = self.run, self.run.record, self.times[-1]
        run.rhs.records[0].origin = start  # type: ignore[union-attr]
        run._core.loop_continue(run.address, np.array([start, stop, stop]))
        record.ended = record.failed = record.raised = 0
        drive(run)
        failure = explain_failure(run, 0)
        if failure is not None:
            return failure
        n, columns = self.field.frame.dim, self.field.columns
        part = run.end[0, -n * columns :].reshape(n, columns).copy()
        total = self.rows[-1][-n * columns :].reshape(n, columns)
        row = run.end[0].copy()
        joint = part[:, :n] @ total
        joint[:, n:] += part[:, n:]
        row[-joint.size :] = joint.ravel()
        self.times.append(stop)
        self.rows.append(row)
        self.parts.append(part)
        # the next interval starts from the identity, with the present size of steps
        reals, integers, points, slopes = run.state()
        points[0, 0, -joint.size :] = np.eye(n, columns).ravel()
        run._core.loop_state(
            run.address, True, reals.T, integers.T, points.transpose(2, 1, 0),
            slopes.transpose(2, 1, 0),
        )  # fmt: skip
        return None

    def by_values(self, inputs: Inputs, own: int) -> Any:
        """Return the derivatives of the end with respect to the values of all samples."""
        n, width = self.field.frame.dim, inputs.width
        sums = [
            np.zeros((len(curve.times), n, int(np.prod(curve.shape)))) for curve in inputs.curves
        ]
        later = np.eye(n)  # the transition matrix from the end of an interval
        for k in range(len(self.parts) - 1, -1, -1):
            part, start = self.parts[k], self.times[k]
            middle = 0.5 * (start + self.times[k + 1])
            moved = later @ part[:, n + own :]
            first = 0
            for curve, total in zip(inputs.curves, sums, strict=True):
                which = slice(first, first + total.shape[-1])
                first = which.stop
                piece = int(np.searchsorted(curve.times, middle, side="right")) - 1
                by_input = moved[:, which]
                if curve.kind == "hold":
                    total[piece] += by_input
                    continue
                before, after = curve.times[piece : piece + 2]
                share = moved[:, width:][:, which] + (start - before) * by_input
                share /= after - before
                total[piece] += by_input - share
                total[piece + 1] += share
            later = later @ part[:, :n]
        shaped = [
            np.moveaxis(total, 0, 1).reshape(n, *curve.values.shape)
            for curve, total in zip(inputs.curves, sums, strict=True)
        ]
        return tuple(shaped) if inputs.together else shaped[0]
