"""Frames: manifolds with vector fields whose flows can be computed."""

from cg.frames.base import FlowOverflowError, Frame
from cg.frames.checking import check
from cg.frames.coadjoint import CoadjointOrbit
from cg.frames.euclidean import Euclidean
from cg.frames.field_frame import FieldFrame
from cg.frames.gl import GL
from cg.frames.grassmann import Grassmann
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.hyperbolic import Hyperbolic
from cg.frames.isospectral import IsospectralOrbit
from cg.frames.joints import Joint
from cg.frames.linear_action import LinearAction
from cg.frames.matrix_frame import MatrixFrame
from cg.frames.matrix_group import MatrixGroup
from cg.frames.phase_space import PhaseSpace
from cg.frames.power import Power
from cg.frames.product import Product
from cg.frames.quaternion import UnitQuaternion
from cg.frames.rotations import hat, vee
from cg.frames.se3 import SE3
from cg.frames.semidirect import Semidirect
from cg.frames.sl import SL
from cg.frames.so import SO
from cg.frames.so3 import SO3
from cg.frames.sp import Sp
from cg.frames.spd import SPD
from cg.frames.sphere import Sphere
from cg.frames.stiefel import Stiefel
from cg.frames.su import SU
from cg.frames.u import U

__all__ = [
    "GL",
    "SE3",
    "SL",
    "SO",
    "SO3",
    "SPD",
    "SU",
    "CoadjointOrbit",
    "Euclidean",
    "FieldFrame",
    "FlowOverflowError",
    "Frame",
    "Grassmann",
    "HomogeneousSpace",
    "Hyperbolic",
    "IsospectralOrbit",
    "Joint",
    "LinearAction",
    "MatrixFrame",
    "MatrixGroup",
    "PhaseSpace",
    "Power",
    "Product",
    "Semidirect",
    "Sp",
    "Sphere",
    "Stiefel",
    "U",
    "UnitQuaternion",
    "check",
    "hat",
    "vee",
]
