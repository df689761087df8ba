"""The integrator ``method="cg"`` of QuTiP's solvers, registered when this module is imported."""

from __future__ import annotations

try:
    from qutip.solver import MESolver, SESolver
except ImportError as error:
    raise ImportError("cg.qutip needs qutip>=5: python -m pip install qutip") from error

from cg.qutip.integrator import LinearIntegrator

__all__ = ["LinearIntegrator"]

for solver in (SESolver, MESolver):
    solver.add_integrator(LinearIntegrator, LinearIntegrator.method)
