"""Test equations with invariants and reference solutions."""

from cg.problems.linear import AffineField, StateDependentRotation
from cg.problems.rigid_body import FreeRigidBody, HeavyTop
from cg.problems.taylor import Reference

__all__ = [
    "AffineField",
    "FreeRigidBody",
    "HeavyTop",
    "Reference",
    "StateDependentRotation",
]
