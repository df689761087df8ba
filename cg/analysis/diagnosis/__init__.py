"""Diagnosis of methods: true order, first violated condition, known mistakes."""

from cg.analysis.diagnosis.diagnosis import Diagnosis, diagnose, diagnose_file
from cg.analysis.diagnosis.drawing import draw_points, draw_tree
from cg.analysis.diagnosis.failing import FailingCondition
from cg.analysis.diagnosis.mistakes import Finding

__all__ = [
    "Diagnosis",
    "FailingCondition",
    "Finding",
    "diagnose",
    "diagnose_file",
    "draw_points",
    "draw_tree",
]
