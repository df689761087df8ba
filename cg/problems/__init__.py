"""Test equations with invariants and reference solutions."""

from cg.problems.heavy_top import HeavyTop
from cg.problems.rotation import StateDependentRotation
from cg.problems.taylor import Reference

__all__ = ["HeavyTop", "Reference", "StateDependentRotation"]
