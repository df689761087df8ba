"""Integration of differential equations on manifolds."""

from cg.integration.ensemble import solve_ensemble
from cg.integration.ivp import integrate, solve_ivp
from cg.integration.loop.dense import DenseOutput
from cg.integration.results import EnsembleSolution, Solution
from cg.integration.rhs.events import Event
from cg.integration.rhs.function import CompiledFunction
from cg.integration.rhs.python import StepTooLongError
from cg.integration.step.implicit import ConvergenceError
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
