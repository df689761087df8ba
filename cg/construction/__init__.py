"""Tools on the set of methods of an order: construct, compose, eliminate, optimise."""

from ..solve.system import ConditionSystem, Structure
from .compose import compose, triple_jump
from .construct import Attempt, Construction, construct
from .drop import drop_stage
from .eliminate import eliminate, eliminate_stage, walk
from .optimise import Goals, fewer_exponentials, optimise, principal_error
from .point import NotExactError, Point, correct, pack_method, solved, sound, to_tableau

__all__ = [
    "Attempt",
    "ConditionSystem",
    "Construction",
    "Goals",
    "NotExactError",
    "Point",
    "Structure",
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
