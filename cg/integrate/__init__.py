"""Integration of differential equations on manifolds."""

from cg.integrate.dense import DenseOutput
from cg.integrate.fixed import integrate
from cg.integrate.implicit import ConvergenceError
from cg.integrate.ivp import solve_ivp
from cg.integrate.result import Solution, Trajectory

__all__ = [
    "ConvergenceError",
    "DenseOutput",
    "Solution",
    "Trajectory",
    "integrate",
    "solve_ivp",
]
