"""Construction of methods: search, eliminate stages and flows, optimise, lift."""

from cg.construction.attempt import Attempt, run_attempt
from cg.construction.candidate import (
    Candidate,
    NotExactError,
    correct,
    pack_method,
    refinable,
    solved,
    to_method,
)
from cg.construction.construct import Construction, construct
from cg.construction.drop import drop_flow, drop_point_stage, drop_stage
from cg.construction.eliminate import eliminate, eliminate_stage, walk
from cg.construction.optimise import Goals, fewer_exponentials, optimise
from cg.construction.settings import ConstructionSettings
from cg.construction.solvers.system import ConditionSystem, Structure

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
