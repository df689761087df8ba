"""The adjoint equation along a solution of a nonlinear equation."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from cg.frames.arrays import Array, Points
from cg.integration.adjoint import Equation, tolerance_of
from cg.integration.loop.dense import DenseOutput
from cg.integration.problem import Problem


def check_without(**given: Any) -> None:
    """Raise ValueError unless arguments that derivatives by the adjoint equation lack are None."""
    for name, value in given.items():
        if value is not None:
            raise ValueError(f"{name} must not be given with derivatives='adjoint', got {value!r}")


def equation_along(joint: Problem, sol: DenseOutput) -> Equation:
    """Return the equation of the problem with derivatives, along a solution without them."""
    rhs: Any = joint.rhs
    count = rhs.variational.count or None
    return Equation(partial(_along, rhs, sol), (rhs.plan.frame.dim,), tolerance_of(joint), count)


def _along(rhs: Any, sol: DenseOutput, times: Array) -> tuple[Points, Array | None]:
    """Return A and B along a solution, from derivatives that are unit vectors."""
    variational = rhs.variational
    n = variational.frame.dim
    values = rhs.at_times(times, variational.start(sol(times)))
    if not np.isfinite(values).all():
        raise ValueError("f and its derivatives must return finite numbers")
    slopes = values[:, n:].reshape(len(times), n, -1)
    return slopes[..., :n], slopes[..., n:] if variational.count else None
