"""Diagnosis of methods: true order, first violated condition, known mistakes."""

from .diagnosis import Diagnosis, diagnose
from .drawing import draw_points, draw_tree
from .failing import FailingCondition
from .files import diagnose_file
from .findings import Finding

__all__ = [
    "Diagnosis",
    "FailingCondition",
    "Finding",
    "diagnose",
    "diagnose_file",
    "draw_points",
    "draw_tree",
]
