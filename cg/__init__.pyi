# What `cg` offers, and where it is: read by type checkers, and by `cg` itself.
from . import conditions, frames, plot, problems
from . import jax as jax  # not in __all__: `from cg import *` would import JAX
from .catalogue import methods
from .certification import Certificate, CertificationError, certify
from .commutator_free import CommutatorFree
from .construction import construct
from .diagnosis import Diagnosis, diagnose
from .formats import export
from .integration import (
    CompiledFunction,
    ConvergenceError,
    DenseOutput,
    EnsembleSolution,
    EnsembleVariationalSolution,
    Event,
    Solution,
    Stepper,
    StepTooLongError,
    VariationalOutput,
    VariationalSolution,
    integrate,
    solve_ensemble,
    solve_ivp,
    solve_variational,
    solve_variational_ensemble,
)
from .lifting import Lifted, LiftError, lift
from .method import Method
from .munthe_kaas import MuntheKaas
from .points import MethodError
from .random_search import search
from .solve.lmdif import lmdif
from .solve.system import Structure
from .tableau import Tableau, TableauError

__all__ = [
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
    "Method",
    "MethodError",
    "MuntheKaas",
    "Solution",
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
    "export",
    "frames",
    "integrate",
    "lift",
    "lmdif",
    "methods",
    "plot",
    "problems",
    "search",
    "solve_ensemble",
    "solve_ivp",
    "solve_variational",
    "solve_variational_ensemble",
]

__version__: str
__distribution__: str
