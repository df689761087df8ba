"""Problems of points with their derivatives, and their solutions as users get them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from cg.frames.facts import facts_of
from cg.integration.derivatives.adjoint import tolerance_of, with_adjoint, with_linear_adjoint
from cg.integration.derivatives.adjoint_equation import AdjointEquation
from cg.integration.derivatives.compiled_variation import CompiledVariation, compiled_variation
from cg.integration.derivatives.noise import check_covariance, noise_of
from cg.integration.derivatives.saltation import VariationalEvents
from cg.integration.derivatives.variational_equation import VariationalEquation, count_parameters
from cg.integration.mechanics import refuse_friction
from cg.integration.options import Options
from cg.integration.output.solutions import DenseOutput, EnsembleSolution
from cg.integration.plan.plan import plan_of
from cg.integration.problem import Problem
from cg.integration.rhs.python import PythonRhs, Rhs, derivative_of, time_text
from cg.support.arrays import Array, Points, check_finite, read_only, real_array
from cg.support.frozen import changed
from cg.tables import Kind


@dataclass(frozen=True, eq=False)
class DerivativeSplitter:
    """Splits points that hold derivatives into the fields of a solution.

    The covariance of the initial coordinates is None or has shape ``(n, n)``, or
    ``(members, n, n)`` if the members are the last of the leading axes of the points.
    """

    equation: VariationalEquation
    initial_covariance: Array | None

    def member(self, member: int) -> DerivativeSplitter:
        """Return the splitter of one member."""
        covariance = self.initial_covariance
        if covariance is None or covariance.ndim == 2:
            return self
        return DerivativeSplitter(self.equation, covariance[member])

    def split(self, z: Array) -> dict[str, Any]:
        """Return the fields of a solution that come from points with derivatives."""
        equation, covariance = self.equation, self.initial_covariance
        y, x = equation.split(z)
        n = equation.frame.dim
        transition = x[..., :n]
        total = None if covariance is None else transition @ covariance @ transition.mT
        if equation.noise is not None:
            added = x[..., n + equation.parameter_count :]
            total = (added + added.mT) / 2 + (0.0 if total is None else total)
        fields = {"y": y, "transition": transition, "covariance": total, "sensitivity": None}
        if equation.directions is not None and not equation.has_point_directions:
            fields |= {"transition": None, "sensitivity": x}
        elif equation.parameter_count and equation.directions is None:
            fields["sensitivity"] = x[..., n : n + equation.parameter_count]
        stored = {name: np.ascontiguousarray(x) for name, x in fields.items() if x is not None}
        return fields | {name: read_only(array) for name, array in stored.items()}

    def split_solution(
        self, problem: Problem, variational: Problem, solution: EnsembleSolution
    ) -> EnsembleSolution:
        """Return the solution of a problem with its derivatives.

        ``solution`` is that of the ``variational`` problem, whose points hold the derivatives.
        """
        fields: Any = self.split(solution.y)
        if isinstance(variational.events, VariationalEvents):
            fields |= self._event_fields(problem, variational.events, solution)
        sol = None if solution.sol is None else solution.sol.with_derivatives(self)
        plan, nfev = problem.plan, int(solution.nfev.sum())
        refuse_friction(plan, problem.rhs, solution.t, fields["y"], nfev)
        return changed(solution, sol=sol, frame=plan.user_frame, **fields)

    def _event_fields(
        self, problem: Problem, table: VariationalEvents, solution: EnsembleSolution
    ) -> dict[str, Any]:
        """Return the fields of a solution that come from events at points with derivatives."""
        tables, split = [table] * len(problem.points), self.equation.split
        if (inertia := problem.inertia) is not None:
            frames = (inertia.frame(k, self.equation.frame) for k in range(len(tables)))
            tables = [table.on_frame(frame) for frame in frames]
        if problem.member_inputs:
            bounds = (_bounds(problem.of_members(slice(k, k + 1))) for k in range(len(tables)))
            pairs = zip(tables, bounds, strict=True)
            tables = [VariationalEvents(each.table, each.equation, own) for each, own in pairs]
        events: Any = solution.t_events, solution.y_events
        fields = {
            name: [[split(z)[0] for z in members] for members in getattr(solution, name)]
            for name in ("y_events", "y_after")
        }
        fields["dt_events"] = [
            [
                tables[member].time_derivatives(index, *times_and_points, problem.arguments(member))
                for member, times_and_points in enumerate(zip(times, points, strict=True))
            ]
            for index, (times, points) in enumerate(zip(*events, strict=True))
        ]
        return fields


# Ratio of the tolerances of derivatives to those of the solution without ``control_derivatives``:
# steps are hardly shorter, and not too long for derivatives where the solution itself is simple
_TOLERANCE_RATIO = 10.0
# the least tolerance of derivatives for which one-sided differences are exact enough
_MIN_ONE_SIDED = 9e-7


def with_derivatives(problem: Problem, options: Options) -> Problem:
    """Return the problem whose solution has the derivatives that options ask for."""
    if problem.linear:
        return with_linear_adjoint(problem, options["df_dp"])
    variational = _forward_problem(problem, options)
    if options["derivatives"] == "adjoint":
        return with_adjoint(problem, partial(_equation_along, variational))
    return variational


def _forward_problem(problem: Problem, options: Options) -> Problem:
    """Return the problem of points with derivatives, after checking the options.

    For the adjoint equation the values of inputs are parameters as well.
    """
    plan, rhs, control, events = problem.plan, problem.rhs, problem.control, problem.events
    _check_problem(problem, options)
    equation = _make_equation(problem, options)
    whole_plan = plan_of(equation.product, plan.table)
    if rhs.vectorized:
        variational_rhs: Rhs = PythonRhs(equation, whole_plan.form, rhs.extra, True)
    else:
        # on frames in Python f gives coefficients, also where that of the user gives derivatives
        plain_plan = plan if plan.compiled else plan_of(plan.frame, plan.table)
        variational_rhs = compiled_variation(equation, plain_plan, rhs.extra)
    if control.h is None:
        rtol, atol = _tolerances(problem, equation, options["control_derivatives"])
        control = control._replace(rtol=rtol, atol=atol)
    members = len(problem.points) if problem.ensemble else None
    covariance = check_covariance(options["P0"], plan.frame.dim, members)
    return changed(
        problem,
        plan=whole_plan,
        rhs=variational_rhs,
        points=equation.start(problem.points),
        control=control,
        events=None if events is None else VariationalEvents(events, equation, _bounds(problem)),
        split_solution=partial(DerivativeSplitter(equation, covariance).split_solution, problem),
    )


def _bounds(problem: Problem) -> Array:
    """Return the ends of the span and where inputs or the right-hand side may jump, in order."""
    bounds = np.append(problem.t0, problem.segment_ends)
    return np.unique(bounds[np.isfinite(bounds)])


def _check_problem(problem: Problem, options: Options) -> None:
    """Raise ValueError if derivatives can't move along the solution."""
    frame, table = problem.plan.frame, problem.plan.table
    if table.kind is Kind.SPLITTING:
        if options["derivatives"] == "adjoint" or options["noise"] is not None:
            raise ValueError(
                "method must not be a splitting method with derivatives='adjoint' or noise, got "
                f"{table!r}"
            )
        for name, label in (("gyroscopic", "gyroscopic forces"), ("jointed", "joints")):
            if getattr(frame, name, None):
                raise ValueError(
                    "method must not be a splitting method with derivatives of motion with "
                    f"{label}, got {table!r}"
                )
    if not facts_of(frame).has_brackets:
        raise ValueError(
            "frame must know the bracket of its fields, by which derivatives move, got "
            f"{frame!r}, whose fields are no Lie algebra or none that it knows"
        )
    if not problem.keeps_points:
        raise ValueError(
            "store must be 'all' where solutions have derivatives, which belong to points, got "
            "'observed'"
        )


def _make_equation(problem: Problem, options: Options) -> VariationalEquation:
    """Return the coefficients of points with derivatives, after checking functions."""
    frame, rhs, df_dp = problem.plan.frame, problem.rhs, options["df_dp"]
    noise = noise_of(options["noise"], problem)
    n, vectorized, inputs = frame.dim, rhs.vectorized, rhs.extra.inputs
    count, width = count_parameters(rhs, df_dp, options["derivatives"] == "adjoint")
    directions = None
    if options["derivatives_by"] is not None:
        directions = _directions(options, n, count, noise)
    return VariationalEquation(
        problem.plan.form, rhs.f if isinstance(rhs, PythonRhs) else rhs,
        derivative_of(options["jac"], "jac", frame, (n, n), vectorized, inputs),
        derivative_of(df_dp, "df_dp", frame, (n, count), vectorized, inputs),
        parameter_count=count, vectorized=vectorized, input_count=width, noise=noise,
        directions=directions, forces_alone=problem.plan.table.kind is Kind.SPLITTING,
        one_sided=_allows_one_sided(problem, options["control_derivatives"]),
    )  # fmt: skip


def _allows_one_sided(problem: Problem, control_derivatives: bool) -> bool:
    """Return whether one-sided differences are exact enough for the tolerances of derivatives."""
    tolerance = problem.control.tolerance or 0.0
    # rounding of t makes f inexact where t is far larger than the span, or than 1 without an end
    span = abs(problem.t1 - problem.t0)
    far = max(1.0, abs(problem.t0) / (span if 0.0 < span < math.inf else 1.0))
    return tolerance * (1.0 if control_derivatives else _TOLERANCE_RATIO) >= _MIN_ONE_SIDED * far


def _directions(options: Options, n: int, k: int, noise: Any) -> Array:
    """Return directions of derivatives in n coordinates and k parameters, as columns."""
    chosen = options["derivatives_by"]
    if options["P0"] is not None or noise is not None:
        raise ValueError("derivatives_by must be None with P0 or noise, which take all derivatives")
    if isinstance(chosen, str):
        if chosen not in ("point", "parameters"):
            raise ValueError(
                f"derivatives_by must be 'point', 'parameters' or a matrix, got {chosen!r}"
            )
        if chosen == "parameters" and not k:
            raise ValueError("parameters must be given with derivatives_by='parameters', got None")
        return np.eye(n + k)[:, slice(n) if chosen == "point" else slice(n, None)]
    matrix = real_array(chosen, "derivatives_by")
    if matrix.ndim != 2 or len(matrix) != n + k or not matrix.size:
        raise ValueError(
            f"derivatives_by must have {n + k} rows, of {n} coordinates and {k} parameters, and a "
            f"column for each direction, got shape {matrix.shape}"
        )
    check_finite("derivatives_by", matrix)
    return matrix


def _tolerances(
    problem: Problem, equation: VariationalEquation, control_derivatives: bool
) -> tuple[Array, Array]:
    """Return tolerances of all coordinates: those of derivatives are larger unless controlled."""
    plan, control, n = problem.plan, problem.control, equation.frame.dim
    tolerances, in_coordinates = np.array([control.rtol, control.atol]), problem.in_coordinates
    tolerances = tolerances.reshape(2, -1)
    derivative_rows = tolerances if in_coordinates else tolerances.min(axis=1, keepdims=True)
    if not control_derivatives:  # derivatives are of size one at first, also with atol = 0
        derivative_rows = _TOLERANCE_RATIO * np.maximum(derivative_rows, tolerances[0].min())
    elif not derivative_rows.min() > 0.0:
        raise ValueError(
            "atol must be positive with control_derivatives, since derivatives are zero at first, "
            f"got {control.atol}"
        )
    # the square of the norm of the whole error is then the sum of those of both parts
    count, others = n if in_coordinates else plan.width, n * equation.column_count
    share = math.sqrt(count / (count + others))
    # errors of a complex entry now count as two real numbers
    complexity = 1.0 if in_coordinates else math.sqrt(plan.reals_per_entry)
    point = tolerances * [[share], [share / complexity]]
    derivative_rows = math.sqrt(others / (count + others)) * derivative_rows
    both = np.empty((2, count + others))
    both[:, :count] = point.repeat(count // point.shape[1], axis=1)
    both[:, count:] = derivative_rows.repeat(others // derivative_rows.shape[1], axis=1)
    return both[0], both[1]


def _equation_along(variational: Problem, sol: DenseOutput) -> AdjointEquation:
    """Return the adjoint equation of a problem with derivatives."""
    rhs = variational.rhs
    assert isinstance(rhs, CompiledVariation)
    shape, along = (rhs.plan.frame.dim,), partial(_matrices_along, rhs, sol)
    tolerance, extra = tolerance_of(variational), rhs.extra
    return AdjointEquation(along, shape, tolerance, extra.parameter_count, extra.inputs)


def _matrices_along(
    rhs: CompiledVariation, sol: DenseOutput, times: Array
) -> tuple[Points, Array | None]:
    """Return A and B along a solution, from derivatives that are unit vectors."""
    equation, n = rhs.equation, rhs.equation.frame.dim
    values = rhs.at_times(times, equation.start(sol(times)))
    if not np.isfinite(values).all():
        k = int(np.isfinite(values).all(axis=1).argmin())
        raise ValueError(
            f"f and its derivatives must return finite numbers, at {time_text(times[k])}"
        )
    slopes = values[:, n:].reshape(len(times), n, -1)
    return slopes[..., :n], slopes[..., n:] if equation.parameter_count else None
