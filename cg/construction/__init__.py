"""Construction of methods: search, eliminate stages and flows, optimise, compose, lift."""

from .attempt import Attempt, run_attempt
from .candidate import Candidate, NotExactError, correct, pack_method, refinable, solved, to_method
from .compose import compose, triple_jump
from .construct import Construction, construct
from .drop import drop_stage
from .drop_flow import drop_flow, drop_point_stage
from .eliminate import eliminate, eliminate_stage, walk
from .optimise import Goals, fewer_exponentials, optimise, principal_error
from .settings import ConstructionSettings
from .solvers.system import ConditionSystem, Structure

__all__ = [
    "Attempt",
    "Candidate",
    "ConditionSystem",
    "Construction",
    "ConstructionSettings",
    "Goals",
    "NotExactError",
    "Structure",
    "compose",
    "construct",
    "correct",
    "drop_flow",
    "drop_point_stage",
    "drop_stage",
    "eliminate",
    "eliminate_stage",
    "fewer_exponentials",
    "optimise",
    "pack_method",
    "principal_error",
    "refinable",
    "run_attempt",
    "solved",
    "to_method",
    "triple_jump",
    "walk",
]
