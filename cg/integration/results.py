"""The results of integrations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.dense import DenseOutput
from cg.later import Later
from cg.method import Method


class _ReadOnly:
    """Keeps arrays that are read-only so in copies."""

    def __getstate__(self) -> dict[str, Any]:
        arrays = {name: value for name, value in vars(self).items() if name in ("t", "y")}
        fixed = [
            name
            for name, value in arrays.items()
            if isinstance(value, np.ndarray) and not value.flags.writeable
        ]
        return {**vars(self), "fixed": fixed}

    def __setstate__(self, state: dict[str, Any]) -> None:
        fixed = state.pop("fixed")
        vars(self).update(state)
        for name in fixed:
            state[name].flags.writeable = False


@dataclass(frozen=True, eq=False)
class Trajectory(_ReadOnly):
    """A numerical solution with fixed steps.

    Attributes
    ----------
    t
        Times, shape ``(n,)``, read-only.  Without ``save_every`` those of all steps.
    y
        Points, shape ``(n, *batch, *point_shape)``, read-only.
    nfev
        Number of evaluations of the coefficients.
    nexp
        Number of flows (exponentials) that were computed; one of a whole ensemble counts once.
    steps
        Number of steps that were taken, stored or not.
    method
        The tableau that was used.
    h
        Absolute size of all steps but perhaps the last.
    failures
        Why members of an ensemble ended early, by their indices.  ``y`` is NaN from there on.
    frame
        The frame that holds the points.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> run = cg.integrate(
    ...     lambda t, y: [0.0, np.sin(t), y[0, 0]], (0, 5), np.eye(3), frame=cg.frames.SO3(),
    ...     method="CG4a", h=0.1,
    ... )
    >>> run
    Trajectory(t=0...5, steps=50, nfev=250, nexp=750, h=0.1)
    >>> run.y.shape
    (51, 3, 3)
    """

    t: Array
    y: Points
    nfev: int
    nexp: int
    steps: int
    method: Method
    h: float
    failures: dict[tuple[int, ...], str] = field(default_factory=dict)
    frame: Frame | None = None
    to_xarray = Later("cg.integration.labelled", "to_xarray")

    def __repr__(self) -> str:
        return (
            f"Trajectory(t={self.t[0]:g}...{self.t[-1]:g}, steps={self.steps}, "
            f"nfev={self.nfev}, nexp={self.nexp}, h={self.h:g})"
        )


@dataclass(frozen=True, eq=False)
class Solution(_ReadOnly):
    """What `cg.solve_ivp` returns, with the field names of SciPy's function.

    Attributes
    ----------
    t
        Times, shape ``(n,)``, read-only.
    y
        Points, shape ``(n, *batch, *point_shape)``, read-only.  Time is the *first* axis, unlike
        in SciPy, since points are arrays of any shape.  Where each member of an ensemble has its
        own steps, NaN at times that a member didn't reach.
    sol
        The continuous solution, or None unless ``dense_output`` was asked for.
    t_events
        For each event the times at which it happened, or None without events.  Of an ensemble an
        array of such arrays, shape ``batch``.
    y_events
        For each event the points, shape ``(n_i, *point_shape)``, or None without events.  Of an
        ensemble an array of such arrays, shape ``batch``.
    nfev
        Evaluations of the coefficients.
    njev, nlu
        Jacobians of stage equations and their factorisations; zero for explicit methods.
    nexp
        Flows (exponentials) that steps and continuous solution took, those of rejected steps
        included.  Those of an ensemble count once for all its members.
    steps
        Accepted steps.
    nrejected
        Rejected steps.  Where each member of an ensemble has its own steps, all these numbers
        are sums over the members.
    status
        0: the end was reached; 1: an event ended the integration; -1: the step size became too
        small or the number of steps too large, and ``t`` and ``y`` hold what had been accepted.
    message
        The same in words.
    success
        Whether ``status`` is at least 0.
    method
        The tableau that was used.
    failures
        Why members of an ensemble ended early, by their indices.  ``y`` is NaN from there on.
    frame
        The frame that holds the points.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> run = cg.solve_ivp(
    ...     lambda t, y: [0.0, np.sin(t), y[0, 0]], (0, 5), np.eye(3), frame=cg.frames.SO3(),
    ...     method="CF4(3)", rtol=1e-6, atol=1e-6, t_eval=[0, 2.5, 5],
    ... )
    >>> run.success, run.y.shape, run.nfev > 4 * run.steps
    (True, (3, 3, 3), True)
    >>> run.message
    'The end of t_span was reached.'
    """

    t: Array
    y: Points
    sol: DenseOutput | None
    t_events: list[Any] | None
    y_events: list[Any] | None
    nfev: int
    njev: int
    nlu: int
    nexp: int
    steps: int
    nrejected: int
    status: int
    message: str
    success: bool
    method: Method
    failures: dict[tuple[int, ...], str] = field(default_factory=dict)
    frame: Frame | None = None
    to_xarray = Later("cg.integration.labelled", "to_xarray")

    def __repr__(self) -> str:
        times = f"{self.t[0]:g}...{self.t[-1]:g}" if len(self.t) else "nothing"
        return (
            f"Solution(t={times}, status={self.status}, steps={self.steps}, "
            f"nrejected={self.nrejected}, nfev={self.nfev}, nexp={self.nexp})"
        )
