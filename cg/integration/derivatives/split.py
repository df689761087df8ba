"""Solutions with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cg.integration.derivatives.events import VariationalEvents
from cg.integration.derivatives.field import VariationalField
from cg.integration.output.results import EnsembleSolution
from cg.integration.problem import Problem
from cg.integration.rhs.events import EventTable
from cg.support.arrays import Array


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Splits points that hold derivatives.

    The covariance of the initial coordinates is None or has shape ``(n, n)``, or
    ``(members, n, n)`` if the members are the last of the leading axes of the points.
    """

    field: VariationalField
    initial_covariance: Array | None

    def of(self, member: int) -> Derivatives:
        """Return the derivatives of one member."""
        covariance = self.initial_covariance
        if covariance is None or covariance.ndim == 2:
            return self
        return Derivatives(self.field, covariance[member])

    def split(self, z: Array) -> dict[str, Any]:
        """Return the fields of a solution that come from points with derivatives."""
        field, covariance = self.field, self.initial_covariance
        y, x = field.split(z)
        n = field.frame.dim
        transition = np.ascontiguousarray(x[..., :n])
        total = None if covariance is None else transition @ covariance @ transition.mT
        if field.noise is not None:
            added = x[..., n + field.count :]
            total = (added + added.mT) / 2 + (0.0 if total is None else total)
        parts: dict[str, Any] = {
            "y": np.ascontiguousarray(y),
            "transition": transition,
            "sensitivity": None,
            "covariance": total,
        }
        if field.chosen is not None and not field.by_point:
            parts["transition"], parts["sensitivity"] = None, np.ascontiguousarray(x)
        elif field.count and field.chosen is None:
            parts["sensitivity"] = np.ascontiguousarray(x[..., n : n + field.count])
        for array in parts.values():
            if array is not None:
                array.flags.writeable = False
        return parts

    def finish(
        self, problem: Problem, table: EventTable | None, joint: EnsembleSolution
    ) -> EnsembleSolution:
        """Return the solution of a problem with its derivatives, of one whose points hold them."""
        split, events = self.field.split, {}
        if isinstance(table, VariationalEvents):
            tables = [table] * len(problem.points)
            if (inertia := problem.inertia) is not None:
                frames = (inertia.frame(k, self.field.frame) for k in range(len(tables)))
                tables = [table.on_frame(frame) for frame in frames]
            assert joint.t_events is not None
            assert joint.y_events is not None
            before = zip(joint.t_events, joint.y_events, strict=True)
            events["dt_events"] = [
                [
                    tables[member].time_derivatives(index, *at, problem.arguments(member))
                    for member, at in enumerate(zip(times, points, strict=True))
                ]
                for index, (times, points) in enumerate(before)
            ]
            for name in ("y_events", "y_after"):
                each = getattr(joint, name)
                events[name] = [[split(z)[0] for z in members] for members in each]
        sol = None if joint.sol is None else joint.sol.with_derivatives(self)
        parts: Any = {**self.split(joint.y), **events}
        return replace(joint, sol=sol, frame=self.field.frame._given or self.field.frame, **parts)
