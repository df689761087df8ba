# The public names and their modules, read by type checkers and by `cg` itself.
from . import conditions, frames, plot, problems
from . import jax as jax  # not in __all__: `from cg import *` would import JAX
from .analysis.diagnosis import Diagnosis, diagnose
from .catalogue import load, methods, save
from .construction import construct
from .construction.lifting import Lifted, LiftError, lift
from .construction.search.random_search import search
from .construction.solvers.lmdif import lmdif
from .construction.solvers.system import Structure
from .formats import export
from .integration import (
    AdjointSolution,
    CompiledFunction,
    ConvergenceError,
    DenseOutput,
    EnsembleSolution,
    EnsembleVariationalSolution,
    Event,
    Samples,
    Solution,
    Stepper,
    StepTooLongError,
    VariationalOutput,
    VariationalSolution,
    integrate,
    solve_ensemble,
    solve_ivp,
    solve_linear,
    solve_linear_ensemble,
    solve_variational,
    solve_variational_ensemble,
)
from .layouts.points import MethodError
from .method.commutator_free import CommutatorFree
from .method.magnus import MagnusMethod
from .method.method import Method
from .method.munthe_kaas import MuntheKaas
from .method.splitting import Splitting
from .method.tableau import Tableau, TableauError
from .proofs import Certificate, CertificationError, certify
from .proofs.digits import digits
from .support.quads import MissingQuadsError

__all__ = [
    "AdjointSolution",
    "Certificate",
    "CertificationError",
    "CommutatorFree",
    "CompiledFunction",
    "ConvergenceError",
    "DenseOutput",
    "Diagnosis",
    "EnsembleSolution",
    "EnsembleVariationalSolution",
    "Event",
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
    "VariationalOutput",
    "VariationalSolution",
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
