"""Integration of differential equations on manifolds."""

from cg.integration.adjoint import AdjointSolution
from cg.integration.ensemble import solve_ensemble
from cg.integration.ivp import integrate, solve_ivp
from cg.integration.linear import solve_linear, solve_linear_ensemble
from cg.integration.loop.dense import DenseOutput
from cg.integration.loop.messages import StepTooLongError
from cg.integration.results import EnsembleSolution, Solution
from cg.integration.rhs.events import Event
from cg.integration.rhs.function import CompiledFunction
from cg.integration.rhs.samples import Samples
from cg.integration.step.implicit import ConvergenceError
from cg.integration.stepper import Stepper
from cg.integration.variational.results import (
    EnsembleVariationalSolution,
    VariationalOutput,
    VariationalSolution,
)
from cg.integration.variational.solve import solve_variational, solve_variational_ensemble

__all__ = [
    "AdjointSolution",
    "CompiledFunction",
    "ConvergenceError",
    "DenseOutput",
    "EnsembleSolution",
    "EnsembleVariationalSolution",
    "Event",
    "Samples",
    "Solution",
    "StepTooLongError",
    "Stepper",
    "VariationalOutput",
    "VariationalSolution",
    "integrate",
    "solve_ensemble",
    "solve_ivp",
    "solve_linear",
    "solve_linear_ensemble",
    "solve_variational",
    "solve_variational_ensemble",
]
