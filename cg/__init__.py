"""Runge–Kutta methods of Crouch–Grossman type: construct them, prove them, integrate with them."""

from __future__ import annotations

from .catalogue import methods
from .solve.lmdif import lmdif
from .tableau import Tableau, TableauError

__all__ = ["Tableau", "TableauError", "lmdif", "methods"]
__version__ = "0.1.0"
