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

__all__ = [
    "CompiledFunction",
    "ConvergenceError",
    "DenseOutput",
    "EnsembleSolution",
    "Event",
    "Solution",
    "StepTooLongError",
    "Stepper",
    "integrate",
    "solve_ensemble",
    "solve_ivp",
]
