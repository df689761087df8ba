"""Test equations with invariants and reference solutions."""

from cg.problems.affine import AffineField
from cg.problems.forced_rigid_body import ForcedRigidBody
from cg.problems.free_rigid_body import FreeRigidBody
from cg.problems.gradient_flow import GradientFlow
from cg.problems.gyro import ConingMotion, GyroAttitude
from cg.problems.heavy_top import HeavyTop
from cg.problems.reaction_wheels import ReactionWheels
from cg.problems.rotation import StateDependentRotation
from cg.problems.spacecraft import Spacecraft
from cg.problems.taylor import Reference
from cg.problems.toda import TodaFlow
from cg.problems.two_level import TwoLevelSystem

__all__ = [
    "AffineField",
    "ConingMotion",
    "ForcedRigidBody",
    "FreeRigidBody",
    "GradientFlow",
    "GyroAttitude",
    "HeavyTop",
    "ReactionWheels",
    "Reference",
    "Spacecraft",
    "StateDependentRotation",
    "TodaFlow",
    "TwoLevelSystem",
]
