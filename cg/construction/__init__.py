"""Construction of methods: search, eliminate stages and flows, optimise, lift."""

from .attempt import Attempt, run_attempt
from .candidate import Candidate, NotExactError, correct, pack_method, refinable, solved, to_method
from .construct import Construction, construct
from .drop import drop_flow, drop_point_stage, drop_stage
from .eliminate import eliminate, eliminate_stage, walk
from .optimise import Goals, fewer_exponentials, optimise
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
    "refinable",
    "run_attempt",
    "solved",
    "to_method",
    "walk",
]
