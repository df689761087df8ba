"""Diagnosis of methods: order, first violated condition, the coefficient that is wrong."""

from cg.construction.diagnosis.correction import Correction
from cg.construction.diagnosis.diagnosis import Diagnosis, FailingCondition, diagnose, diagnose_file

__all__ = ["Correction", "Diagnosis", "FailingCondition", "diagnose", "diagnose_file"]
