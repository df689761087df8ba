# The public names and their modules, read by type checkers and by `cg.frames` itself.
from .base import FlowOverflowError, Frame
from .checking import check
from .coadjoint import CoadjointOrbit
from .euclidean import Euclidean
from .field_frame import FieldFrame
from .gl import GL
from .grassmann import Grassmann
from .homogeneous import HomogeneousSpace
from .hyperbolic import Hyperbolic
from .isospectral import IsospectralOrbit
from .joints import Joint
from .linear_action import LinearAction
from .matrix_frame import MatrixFrame
from .matrix_group import MatrixGroup
from .phase_space import PhaseSpace
from .power import Power
from .product import Product
from .quaternion import UnitQuaternion
from .rotations import hat, vee
from .se3 import SE3
from .semidirect import Semidirect
from .sl import SL
from .so import SO
from .so3 import SO3
from .sp import Sp
from .spd import SPD
from .sphere import Sphere
from .stiefel import Stiefel
from .su import SU
from .u import U

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
