"""What long runs have found: their best starts, distinct solutions, and methods made of them."""

from __future__ import annotations

from .publish import Promotion, promote
from .solutions import Solution, best, families, solutions

__all__ = ["Promotion", "Solution", "best", "families", "promote", "solutions"]
