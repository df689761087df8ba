"""Test equations with invariants and reference solutions."""

from cg.problems.affine import AffineField
from cg.problems.forced_rigid_body import ForcedRigidBody
from cg.problems.free_rigid_body import FreeRigidBody
from cg.problems.heavy_top import HeavyTop
from cg.problems.rotation import StateDependentRotation
from cg.problems.taylor import Reference

__all__ = [
    "AffineField",
    "ForcedRigidBody",
    "FreeRigidBody",
    "HeavyTop",
    "Reference",
    "StateDependentRotation",
]
