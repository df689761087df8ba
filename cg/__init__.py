"""Runge–Kutta methods of Crouch–Grossman type: construct them, prove them, integrate with them."""

from __future__ import annotations

from . import frames, problems
from .catalogue import methods
from .certification import Certificate, CertificationError, certify
from .construction import construct
from .integration import ConvergenceError, integrate, solve_ivp
from .random_search import search
from .solve.lmdif import lmdif
from .solve.system import Structure
from .tableau import Tableau, TableauError

__all__ = [
    "Certificate",
    "CertificationError",
    "ConvergenceError",
    "Structure",
    "Tableau",
    "TableauError",
    "certify",
    "construct",
    "frames",
    "integrate",
    "lmdif",
    "methods",
    "problems",
    "search",
    "solve_ivp",
]
__version__ = "0.1.0"
