"""Integration of differential equations on manifolds."""

from cg.integration.ensemble import (
    solve_ensemble,
    solve_linear_ensemble,
    solve_variational_ensemble,
)
from cg.integration.errors import ConvergenceError, StepTooLongError
from cg.integration.heat_bath import Langevin
from cg.integration.ivp import integrate, solve_ivp, solve_linear, solve_variational
from cg.integration.output.solutions import DenseOutput, EnsembleSolution, Solution
from cg.integration.rhs.events import Event
from cg.integration.rhs.function import CompiledFunction
from cg.integration.rhs.samples import Samples
from cg.integration.stepper import Stepper

__all__ = [
    "CompiledFunction",
    "ConvergenceError",
    "DenseOutput",
    "EnsembleSolution",
    "Event",
    "Langevin",
    "Samples",
    "Solution",
    "StepTooLongError",
    "Stepper",
    "integrate",
    "solve_ensemble",
    "solve_ivp",
    "solve_linear",
    "solve_linear_ensemble",
    "solve_variational",
    "solve_variational_ensemble",
]
