"""The command ``crouch-grossman``, the same as ``python -m cg``."""

from .main import main

__all__ = ["main"]
