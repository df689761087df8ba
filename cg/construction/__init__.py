"""Tools on the set of methods of an order: construct, compose, eliminate, optimise."""

from ..solve.system import Structure, System
from .compose import compose, triple_jump
from .construct import Attempt, Construction, construct
from .drop import drop_stage
from .eliminate import eliminate, eliminate_stage, walk
from .optimise import Goals, fewer_exponentials, optimise, principal_error
from .point import NotExactError, Point, correct, pack_method, solved, sound, to_tableau

__all__ = [
    "Attempt",
    "Construction",
    "Goals",
    "NotExactError",
    "Point",
    "Structure",
    "System",
    "compose",
    "construct",
    "correct",
    "drop_stage",
    "eliminate",
    "eliminate_stage",
    "fewer_exponentials",
    "optimise",
    "pack_method",
    "principal_error",
    "solved",
    "sound",
    "to_tableau",
    "triple_jump",
    "walk",
]
