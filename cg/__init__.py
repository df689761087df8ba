"""Runge–Kutta methods of Crouch–Grossman type: construct them, prove them, integrate with them."""

from __future__ import annotations

from .solve.lmdif import lmdif

__all__ = ["lmdif"]
__version__ = "0.1.0"
