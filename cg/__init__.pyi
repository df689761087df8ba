# The public names and their modules, read by type checkers and by `cg` itself.
from . import conditions, frames, plot, problems
from . import jax as jax  # not in __all__: `from cg import *` would import JAX
from .construction.catalogue import load, methods, save
from .construction.diagnosis import Diagnosis, diagnose
from .construction.formats import export
from .construction.lifting import Lifted, LiftError, lift
from .construction.methods.commutator_free import CommutatorFree, MuntheKaas
from .construction.methods.magnus import MagnusMethod
from .construction.methods.method import Method
from .construction.methods.splitting import Splitting
from .construction.methods.tableau import Tableau, TableauError
from .construction.points import MethodError
from .construction.proofs import Certificate, CertificationError, certify
from .construction.proofs.digits import digits
from .construction.search.construct import construct
from .construction.search.random_search import search
from .construction.solvers.lmdif import lmdif
from .construction.solvers.system import Structure
from .integration import (
    CompiledFunction,
    ConvergenceError,
    DenseOutput,
    EnsembleSolution,
    Event,
    Langevin,
    Samples,
    Solution,
    Stepper,
    StepTooLongError,
    integrate,
    solve_ensemble,
    solve_ivp,
    solve_linear,
    solve_linear_ensemble,
    solve_variational,
    solve_variational_ensemble,
)
from .integration.derivatives.adjoint import Adjoint
from .support.quads import MissingQuadsError

__all__ = [
    "Adjoint",
    "Certificate",
    "CertificationError",
    "CommutatorFree",
    "CompiledFunction",
    "ConvergenceError",
    "DenseOutput",
    "Diagnosis",
    "EnsembleSolution",
    "Event",
    "Langevin",
    "LiftError",
    "Lifted",
    "MagnusMethod",
    "Method",
    "MethodError",
    "MissingQuadsError",
    "MuntheKaas",
    "Samples",
    "Solution",
    "Splitting",
    "StepTooLongError",
    "Stepper",
    "Structure",
    "Tableau",
    "TableauError",
    "certify",
    "conditions",
    "construct",
    "diagnose",
    "digits",
    "export",
    "frames",
    "integrate",
    "lift",
    "lmdif",
    "load",
    "methods",
    "plot",
    "problems",
    "save",
    "search",
    "solve_ensemble",
    "solve_ivp",
    "solve_linear",
    "solve_linear_ensemble",
    "solve_variational",
    "solve_variational_ensemble",
]

__version__: str
__distribution__: str
