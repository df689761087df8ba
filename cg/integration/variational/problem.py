"""Problems of points with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, check_finite, real_array
from cg.frames.base import Frame
from cg.frames.phase_space import PhaseSpace
from cg.integration.problem import Problem, make_rhs
from cg.integration.rhs.compiled import compiled_rhs
from cg.integration.step.plan import has_brackets, plan_of
from cg.integration.variational.compiled import compiled_variation
from cg.integration.variational.events import VariationalEvents
from cg.integration.variational.field import VariationalField
from cg.method.splitting import Splitting
from cg.support.checks import check_flag

# tolerance relative to the largest entry or eigenvalue of a covariance
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class VariationalProblem(Problem):
    """An integration of points with their derivatives.

    Attributes
    ----------
    field
        The functions of the right-hand side.
    """

    field: VariationalField | None = None

    @property
    def variational(self) -> VariationalField:
        """The right-hand side."""
        assert self.field is not None
        return self.field

    def event_table(self) -> VariationalEvents:
        """Return the events, whose functions receive points without derivatives."""
        return VariationalEvents(self.events, self.arguments(), self.variational)


def add_derivatives(
    problem: Problem, f: Any, jac: Any, df_dp: Any, control_derivatives: Any
) -> VariationalProblem:
    """Return the problem of points with derivatives, after checking the arguments.

    Further arguments are those of `cg.solve_variational`.
    """
    frame, rhs = problem.plan.frame, problem.rhs
    control_derivatives = check_flag("control_derivatives", control_derivatives)
    if isinstance(problem.plan.method, Splitting):
        raise ValueError(
            f"method must not be a splitting method, got {problem.plan.method!r}, which moves no "
            "derivatives"
        )
    check_by_differences(frame, jac=jac, df_dp=df_dp)
    if not has_brackets(frame):
        raise ValueError(
            "frame must know the bracket of its fields, by which derivatives move, got "
            f"{frame!r}, whose fields are no Lie algebra or none that it knows"
        )
    numbers = rhs.parameters
    if df_dp is not None and numbers is None:
        raise ValueError(f"parameters must be given with df_dp = {df_dp!r}, got None")
    if numbers is not None:
        check_finite(numbers, "parameters")
    check_function(jac, "jac", rhs.vectorized)
    check_function(df_dp, "df_dp", rhs.vectorized)
    field = VariationalField(
        frame,
        f,
        jac,
        df_dp,
        0 if numbers is None else numbers.shape[-1],
        rhs.vectorized,
    )
    members = len(problem.points)
    source = compiled_variation(field, problem.plan, problem.args) or field
    joint, _ = make_rhs(
        source, field.product, problem.args or None, numbers, rhs.vectorized, members
    )
    control = problem.control
    if control.h is None:
        control = control._replace(atol=_tolerances(problem, field, control_derivatives))
    same = {entry.name: getattr(problem, entry.name) for entry in fields(problem)}
    changed = {
        "plan": plan_of(field.product, problem.plan.method),
        "rhs": joint,
        "points": field.start(problem.points),
        "control": control,
        "f": source,
    }
    return VariationalProblem(**(same | changed), field=field)


def check_by_differences(frame: Frame, **functions: Any) -> None:
    """Raise ValueError if there are derivatives of forces, which are those of no coefficients."""
    for name, function in functions.items():
        if function is not None and isinstance(frame, PhaseSpace):
            raise ValueError(
                f"{name} must be None on a phase space, where derivatives are differences, got "
                f"{function!r}"
            )


def check_function(function: Any, name: str, vectorized: bool) -> None:
    """Raise TypeError or ValueError unless a function can be called, or is None."""
    compiled = compiled_rhs(function, name)
    if compiled is None and not (function is None or callable(function)):
        raise TypeError(f"{name} must be callable as {name}(t, y), got {function!r}")
    if compiled is not None and vectorized:
        raise ValueError(f"vectorized must be False for a compiled {name}, which takes one point")


def _tolerances(problem: Problem, field: VariationalField, control_derivatives: bool) -> Array:
    """Return absolute tolerances of all coordinates, infinite for those without error control."""
    plan, given = problem.plan, problem.control.atol
    n = field.frame.dim
    own = np.broadcast_to(np.asarray(given), plan.tolerance_shape).ravel()
    rows = own if plan.in_algebra else np.full(n, own.min())
    if not plan.in_algebra:
        # the norm is that of numbers here, and that of complex entries there
        own = np.repeat(own, plan.parts) / np.sqrt(plan.parts)
    if control_derivatives and not rows.min() > 0.0:
        raise ValueError(
            "atol must be positive with control_derivatives, since derivatives are zero at first, "
            f"got {given}"
        )
    others = np.repeat(rows, n + field.count)
    return np.concatenate([own, others if control_derivatives else np.full(others.size, np.inf)])


def check_covariance(P0: ArrayLike | None, n: int, members: int | None) -> Array | None:
    """Return the covariance of initial coordinates, or one for each member, after checking it."""
    if P0 is None:
        return None
    matrix = real_array(P0, "P0")
    shapes = [(n, n)] if members is None else [(n, n), (members, n, n)]
    if matrix.shape not in shapes:
        raise ValueError(f"P0 must have shape {' or '.join(map(str, shapes))}, got {matrix.shape}")
    check_finite(matrix, "P0")
    if not np.abs(matrix - matrix.mT).max() <= _ROUNDING * np.abs(matrix).max():
        raise ValueError(f"P0 must be symmetric, got {P0!r}")
    eigenvalues = np.linalg.eigvalsh(matrix)
    if not eigenvalues.min() >= -_ROUNDING * np.abs(eigenvalues).max():
        raise ValueError(
            f"P0 must be positive semidefinite, got one with the eigenvalue {eigenvalues.min():.3g}"
        )
    return matrix
