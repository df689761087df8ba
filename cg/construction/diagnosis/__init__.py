"""Diagnosis of methods: true order, first violated condition, known mistakes."""

from cg.construction.diagnosis.diagnosis import Diagnosis, diagnose, diagnose_file
from cg.construction.diagnosis.drawing import draw_points, draw_tree
from cg.construction.diagnosis.failing import FailingCondition
from cg.construction.diagnosis.mistakes import Finding

__all__ = [
    "Diagnosis",
    "FailingCondition",
    "Finding",
    "diagnose",
    "diagnose_file",
    "draw_points",
    "draw_tree",
]
