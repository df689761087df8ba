"""Derivatives of solutions with respect to initial points and parameters."""

from cg.integration.variational.results import (
    EnsembleVariationalSolution,
    VariationalOutput,
    VariationalSolution,
)
from cg.integration.variational.solve import solve_variational, solve_variational_ensemble

__all__ = [
    "EnsembleVariationalSolution",
    "VariationalOutput",
    "VariationalSolution",
    "solve_variational",
    "solve_variational_ensemble",
]
