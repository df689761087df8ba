"""Integration of differential equations on manifolds."""

from cg.integration.compiled_function import CompiledFunction
from cg.integration.dense import DenseOutput
from cg.integration.fixed import integrate
from cg.integration.implicit import ConvergenceError
from cg.integration.ivp import solve_ivp
from cg.integration.python_rhs import StepTooLongError
from cg.integration.results import Solution, Trajectory

__all__ = [
    "CompiledFunction",
    "ConvergenceError",
    "DenseOutput",
    "Solution",
    "StepTooLongError",
    "Trajectory",
    "integrate",
    "solve_ivp",
]
