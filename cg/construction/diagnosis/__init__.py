"""Diagnosis of methods: order, first violated condition, the coefficient that is wrong."""

from cg.construction.diagnosis.correction import Correction
from cg.construction.diagnosis.diagnosis import Diagnosis, diagnose, diagnose_file
from cg.construction.diagnosis.failing import FailingCondition

__all__ = ["Correction", "Diagnosis", "FailingCondition", "diagnose", "diagnose_file"]
