"""The command ``crouch-grossman``, the same as ``python -m cg``."""

from cg.command.main import main

__all__ = ["main"]
