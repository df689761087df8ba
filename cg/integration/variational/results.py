"""Solutions with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.integration.loop.dense import DenseOutput, EnsembleOutput
from cg.integration.problem import Problem
from cg.integration.results import EnsembleSolution, Solution
from cg.integration.variational.events import VariationalEvents
from cg.integration.variational.field import VariationalField
from cg.support.arrays import Array, Points


def split_results(
    z: Array, variational: VariationalField, covariance: Array | None
) -> dict[str, Any]:
    """Return the fields of a result that come from points with derivatives ``z``.

    The covariance of the initial coordinates is None or has shape ``(n, n)``, or
    ``(members, n, n)`` if the members are the last of the leading axes of ``z``.
    """
    y, x = variational.split(z)
    n = variational.frame.dim
    transition = np.ascontiguousarray(x[..., :n])
    total = None if covariance is None else transition @ covariance @ transition.mT
    if variational.noise is not None:
        added = x[..., n + variational.count :]
        total = (added + added.mT) / 2 + (0.0 if total is None else total)
    parts: dict[str, Any] = {
        "y": np.ascontiguousarray(y),
        "transition": transition,
        "sensitivity": None,
        "covariance": total,
    }
    if variational.count:
        parts["sensitivity"] = np.ascontiguousarray(x[..., n : n + variational.count])
    for array in parts.values():
        if array is not None:
            array.flags.writeable = False
    return parts


class VariationalOutput(DenseOutput):
    """A solution and its derivatives as functions of time.

    Attributes
    ----------
    t_min, t_max
        The interval of the solution.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> solution = cg.solve_variational(
    ...     lambda t, y: [np.sin(t), 0.0, y[0, 0]], (0, 5), np.eye(3), frame=cg.frames.SO3(),
    ...     dense_output=True,
    ... )
    >>> solution.sol([1.0, 2.0]).shape, solution.sol.transition([1.0, 2.0]).shape
    ((2, 3, 3), (2, 3, 3))
    """

    def __init__(
        self, output: DenseOutput, variational: VariationalField, covariance: Array | None
    ) -> None:
        self._output: DenseOutput = output
        self._field = variational
        self._covariance = covariance
        self.t_min, self.t_max = output.t_min, output.t_max
        self._direction = output._direction

    @cached_property
    def ts(self) -> Array:  # type: ignore[override]
        """The times of the steps."""
        return self._output.ts

    def __repr__(self) -> str:
        return f"Variational{self._output!r}"

    def __call__(self, t: ArrayLike) -> Points:
        """Return the solution at times, shape ``(*t.shape, *point_shape)``."""
        return self._part("y", t)

    def transition(self, t: ArrayLike) -> Array:
        """Return transition matrices, shape ``(*t.shape, dim, dim)``."""
        return self._part("transition", t)

    def sensitivity(self, t: ArrayLike) -> Array | None:
        """Return derivatives by parameters, shape ``(*t.shape, dim, k)``; None without any."""
        return self._part("sensitivity", t)

    def covariance(self, t: ArrayLike) -> Array | None:
        """Return covariances, shape ``(*t.shape, dim, dim)``; None without ``P0`` and noise."""
        return self._part("covariance", t)

    def _part(self, name: str, t: ArrayLike) -> Points:
        parts: dict[str, Points] = split_results(self._output(t), self._field, self._covariance)
        return parts[name]


class EnsembleVariationalOutput(VariationalOutput, EnsembleOutput):
    """The solutions of the members of an ensemble, and their derivatives, as functions of time.

    The members are the axis after those of the times; ``output[i]`` is the `VariationalOutput` of
    a member.
    """

    def __getitem__(self, member: int) -> VariationalOutput:
        output, covariance = self._output, self._covariance
        assert isinstance(output, EnsembleOutput)
        if covariance is not None and covariance.ndim > 2:
            covariance = covariance[member]
        return VariationalOutput(output[member], self._field, covariance)


@dataclass(frozen=True, eq=False, repr=False)
class VariationalSolution(Solution):
    """What `cg.solve_variational` returns: a `Solution` with its derivatives.

    The derivative of ``y[i]`` with respect to a number has coordinates ``xi`` in the frame if it is
    the tangent ``frame.field(xi, y[i])``.

    Attributes
    ----------
    transition
        Derivatives of the coordinates of ``y`` with respect to those of ``y0``, shape
        ``(times, dim, dim)``, read-only.
    sensitivity
        The same with respect to the parameters, shape ``(times, dim, k)``, or None without any.
    covariance
        ``transition @ P0 @ transition.T`` at each time, and what noise adds to it, shape
        ``(times, dim, dim)``; or None without ``P0`` and noise.
    dt_events
        For each event the derivatives of its times with respect to the coordinates of ``y0``, then
        the parameters, shape ``(n_i, dim + k)``, or None without events.
    sol
        A continuous solution, which is a function of time as `DenseOutput` is and has the methods
        ``transition``, ``sensitivity`` and ``covariance``; or None without ``dense_output``.

    Examples
    --------
    A body makes half a turn about its z axis; small errors in body axes rotate in the opposite
    direction.

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> solution = cg.solve_variational(
    ...     lambda t, y, rate: [0.0, 0.0, rate[0]], (0, np.pi), np.eye(3), frame=cg.frames.SO3(),
    ...     parameters=[1.0], P0=np.diag([1e-4, 4e-4, 1e-4]), rtol=1e-9, atol=1e-9,
    ...     control_derivatives=True,
    ... )
    >>> solution.transition[-1].round(9) + 0.0
    array([[-1.,  0.,  0.],
           [ 0., -1.,  0.],
           [ 0.,  0.,  1.]])
    >>> solution.sensitivity[-1].ravel().round(6) + 0.0
    array([0.      , 0.      , 3.141593])
    """

    transition: Array = field(kw_only=True)
    sensitivity: Array | None = field(kw_only=True)
    covariance: Array | None = field(kw_only=True)
    dt_events: list[Array] | None = field(kw_only=True)


@dataclass(frozen=True, eq=False, repr=False)
class EnsembleVariationalSolution(EnsembleSolution):
    """What `cg.solve_variational_ensemble` returns: an `EnsembleSolution` with derivatives.

    ``solution[i]`` is the `VariationalSolution` of a member.

    Attributes
    ----------
    transition, sensitivity, covariance
        As those of `VariationalSolution`, with the members as second axis; NaN at times that a
        member didn't reach.
    dt_events
        For each event a list of the members' arrays, or None without events.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> solution = cg.solve_variational_ensemble(
    ...     lambda t, y, rate: [0.0, np.sin(t), rate[0]], (0, 5), np.eye(3),
    ...     frame=cg.frames.SO3(), parameters=[[0.5], [1.0]], t_eval=[0, 2.5, 5],
    ... )
    >>> solution.transition.shape, solution[1].sensitivity.shape
    ((3, 2, 3, 3), (3, 3, 1))
    """

    transition: Array = field(kw_only=True)
    sensitivity: Array | None = field(kw_only=True)
    covariance: Array | None = field(kw_only=True)
    dt_events: list[list[Array]] | None = field(kw_only=True)

    def __getitem__(self, member: int) -> VariationalSolution:
        return VariationalSolution(**self._fields_of(range(len(self))[member]))

    def _fields_of(self, member: int) -> dict[str, Any]:
        fields, times = super()._fields_of(member), self.dt_events
        for name in ("transition", "sensitivity", "covariance"):
            array = getattr(self, name)
            fields[name] = None if array is None else array[: len(fields["t"]), member]
        fields["dt_events"] = None if times is None else [members[member] for members in times]
        return fields


@dataclass(frozen=True, eq=False)
class SolutionMaker:
    """Makes solutions from points that hold derivatives, by splitting them."""

    variational: VariationalField
    covariance: Array | None

    def __call__(self, problem: Problem, fields: dict[str, Any]) -> EnsembleVariationalSolution:
        """Return the solution of a problem with the fields of an `EnsembleSolution`."""
        split, table = self.variational.split, problem.events
        if fields["sol"] is not None:
            parts = fields["sol"], self.variational, self.covariance
            fields["sol"] = EnsembleVariationalOutput(*parts)
        fields["dt_events"] = None
        if isinstance(table, VariationalEvents):
            before = zip(fields["t_events"], fields["y_events"], strict=True)
            fields["dt_events"] = [
                [
                    table.time_derivatives(index, *at, problem.rhs.arguments(member))
                    for member, at in enumerate(zip(times, points, strict=True))
                ]
                for index, (times, points) in enumerate(before)
            ]
            for name in ("y_events", "y_after"):
                fields[name] = [[split(z)[0] for z in members] for members in fields[name]]
        fields |= split_results(fields["y"], self.variational, self.covariance)
        return EnsembleVariationalSolution(
            **fields | {"frame": self.variational.frame._given or self.variational.frame}
        )
