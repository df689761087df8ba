# The public names and their modules, read by type checkers and by `cg.frames` itself.
from .base import FlowOverflowError, Frame
from .checking import check
from .coadjoint import CoadjointOrbit
from .euclidean import Euclidean
from .homogeneous import HomogeneousSpace
from .joints import Joint
from .linear_action import LinearAction
from .matrix_frame import MatrixFrame
from .matrix_group import MatrixGroup
from .matrix_groups import GL, SL, SU, Sp, U
from .phase_space import PhaseSpace
from .product import Power, Product
from .quaternion import UnitQuaternion
from .rotations import SE3, SO, SO3, hat, vee
from .semidirect import Semidirect
from .sphere import Hyperbolic, Sphere
from .stiefel import Grassmann, Stiefel
from .symmetric import SPD, IsospectralOrbit
from .user import FieldFrame

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
