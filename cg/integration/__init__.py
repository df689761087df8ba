"""Integration of differential equations on manifolds."""

from cg.integration.compiled_function import CompiledFunction
from cg.integration.dense import DenseOutput
from cg.integration.ensemble import solve_ensemble
from cg.integration.events import Event
from cg.integration.implicit import ConvergenceError
from cg.integration.ivp import integrate, solve_ivp
from cg.integration.python_rhs import StepTooLongError
from cg.integration.results import EnsembleSolution, Solution
from cg.integration.stepper import Stepper
from cg.integration.variational import (
    EnsembleVariationalSolution,
    VariationalOutput,
    VariationalSolution,
    solve_variational,
    solve_variational_ensemble,
)

__all__ = [
    "CompiledFunction",
    "ConvergenceError",
    "DenseOutput",
    "EnsembleSolution",
    "EnsembleVariationalSolution",
    "Event",
    "Solution",
    "StepTooLongError",
    "Stepper",
    "VariationalOutput",
    "VariationalSolution",
    "integrate",
    "solve_ensemble",
    "solve_ivp",
    "solve_variational",
    "solve_variational_ensemble",
]
