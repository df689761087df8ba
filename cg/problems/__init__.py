"""Test equations with invariants and reference solutions."""

from cg.problems.linear import StateDependentRotation
from cg.problems.rigid_body import FreeRigidBody, HeavyTop
from cg.problems.taylor import Reference

__all__ = ["FreeRigidBody", "HeavyTop", "Reference", "StateDependentRotation"]
